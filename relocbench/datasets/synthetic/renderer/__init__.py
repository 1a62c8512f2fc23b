"""Images with exact depth, by casting rays."""
