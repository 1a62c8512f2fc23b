"""Verification: evidence for and against a registration, and the verdict."""
