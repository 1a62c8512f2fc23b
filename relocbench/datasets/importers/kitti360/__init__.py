"""Sequences in the layout of KITTI-360."""
