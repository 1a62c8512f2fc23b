"""All registrations of two drives at once: which to believe, and the poses with covariances."""
