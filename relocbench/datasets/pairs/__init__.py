"""Pairing of images, and the ground truth of a pair's individual pixels."""
