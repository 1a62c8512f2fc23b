"""Depth images from submaps, and how stereo agrees with them."""
