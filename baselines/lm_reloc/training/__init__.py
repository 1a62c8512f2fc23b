"""The training of the pose network."""
