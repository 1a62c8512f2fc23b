"""Predictions that somebody else made, checked and brought into a results folder."""
