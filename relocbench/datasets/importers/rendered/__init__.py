"""Datasets for which nothing was recorded: rendered towns, and their buildings from above."""
