"""Datasets as training data."""
