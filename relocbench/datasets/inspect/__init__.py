"""What people look at: a dataset in numbers, and its truth drawn over its images."""
