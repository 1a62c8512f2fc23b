"""Odometry computed from lidar, for drives that have none."""
