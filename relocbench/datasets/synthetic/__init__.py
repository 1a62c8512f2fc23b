"""A procedural town in any weather: districts, conditions, a ray-cast renderer, drives, lidar and field recordings.

World axes: x east, y north, z up, metres. Everything follows from explicit seeds.
"""
