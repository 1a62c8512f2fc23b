"""Submaps: blocks put together along the odometry, with the planes and the free space that registration uses."""
