"""relocalization."""
