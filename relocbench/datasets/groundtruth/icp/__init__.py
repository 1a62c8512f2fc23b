"""The pose between two submaps, from a prediction."""
