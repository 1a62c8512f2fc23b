"""Drives in the layout of the NCLT dataset."""
