"""What all trainers of this package share: the training loop, its log, checkpoints, curves and model cards."""
