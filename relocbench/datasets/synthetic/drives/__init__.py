"""Drives through a district: routes, motion, camera rigs, other traffic, and simulated odometry."""
