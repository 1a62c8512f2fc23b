"""Drives cut into blocks: the lidar points of a few metres of road each, with a score of how static they are."""
