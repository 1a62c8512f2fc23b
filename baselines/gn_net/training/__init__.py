"""Training of GN-Net and its variants: options, batches, steps, checkpoints."""
