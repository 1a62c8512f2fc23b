"""Drives in the layout of the MulRan dataset."""
