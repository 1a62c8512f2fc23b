"""The build of a dataset with ground truth from recordings."""
