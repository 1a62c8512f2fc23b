"""Simulated lidars in any weather."""
