"""Depth images from submaps, and their comparison with stereo."""
