"""Recordings of ROS: bags of ROS 1, bags of ROS 2 (SQLite and MCAP), and single MCAP files."""
