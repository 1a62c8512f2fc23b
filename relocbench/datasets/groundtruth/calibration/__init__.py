"""Calibration of the lidars, estimated along with the poses of two drives: time offsets and extrinsics."""
