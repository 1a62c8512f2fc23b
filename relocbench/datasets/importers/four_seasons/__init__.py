"""Recordings of 4Seasons and MLAD."""
