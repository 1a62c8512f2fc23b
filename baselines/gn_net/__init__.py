"""GN-Net: feature maps on which direct alignment converges across weather, light and season."""
