"""Recordings in this project's own minimal layout."""
