"""Recordings in the layout of KITTI odometry."""
