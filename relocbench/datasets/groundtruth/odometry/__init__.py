"""Odometry from lidar, for drives that have none."""
