"""Summaries of datasets, and pictures of the truth drawn over the images."""
