"""The pose graph of two drives: which registrations to trust, and poses of all nodes with covariances."""
