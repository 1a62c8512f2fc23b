"""The dataset in memory and on disk, its importers, its correspondences."""
