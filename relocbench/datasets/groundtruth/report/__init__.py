"""Pictures and the page of a dataset's ground truth."""
