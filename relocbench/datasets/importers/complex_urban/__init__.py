"""Drives in the layout of the Complex Urban dataset."""
