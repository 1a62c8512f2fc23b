"""Recordings in the layout of TUM RGB-D."""
