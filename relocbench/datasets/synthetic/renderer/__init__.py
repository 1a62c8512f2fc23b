"""The renderer: images with exact depth by ray casting."""
