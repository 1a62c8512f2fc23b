"""From recordings to a dataset with ground truth."""
