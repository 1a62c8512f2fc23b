"""Models of COLMAP and of what writes its format, such as hloc."""
