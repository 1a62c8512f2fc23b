"""The training of GN-Net and its variants."""
