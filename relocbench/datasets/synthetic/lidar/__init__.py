"""Lidars in the weather."""
