"""Folders of point clouds with times, which need no description."""
