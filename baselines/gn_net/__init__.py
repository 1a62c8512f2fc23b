"""GN-Net: learned feature maps on which direct alignment converges across weather, light and season."""
