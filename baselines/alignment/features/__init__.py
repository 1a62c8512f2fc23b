"""Image alignment on feature maps of D channels (GN-Net)."""
