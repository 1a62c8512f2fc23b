"""Drives in the layout of the Boreas dataset."""
