"""Datasets of poses alone: from trajectories, and from files of pairs."""
