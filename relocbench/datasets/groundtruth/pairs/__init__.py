"""Pairs of images of two drives: which are paired, with what pose and covariance, and why a pair is rejected."""
