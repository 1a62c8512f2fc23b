"""Drives in the layout of the HeLiPR dataset."""
