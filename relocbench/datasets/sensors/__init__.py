"""The parts of recordings, independent of their format: drives, point clouds, trajectories, stereo."""
