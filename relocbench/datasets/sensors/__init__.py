"""What recordings are made of, whatever their format: drives, point clouds, trajectories, stereo."""
