"""Rendered datasets: drives through procedural towns, and cross-view sets of their buildings."""
