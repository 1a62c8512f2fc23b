"""Photographs as a camera that moved sees them: made-up depth, drawn motions and light, exact truth."""
