"""ICP: the relative pose of two submaps, starting from a prediction."""
