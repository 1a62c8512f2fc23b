"""Blocks laid together along the odometry, and what registration makes of them."""
