"""Validation: every fault of a dataset on disk, with file and line."""
