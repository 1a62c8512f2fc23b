"""Drives cut into blocks: the points of a few metres of road each, without what moved."""
