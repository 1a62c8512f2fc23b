"""The plain recipe: pairs of submaps by Open3D, each from the solution of the one before, and none verified."""
