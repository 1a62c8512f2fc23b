"""Datasets in memory and on disk, and everything that makes, checks and shows them."""
