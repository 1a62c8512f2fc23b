"""Logs in the layout of the Ford Multi-AV Seasonal dataset."""
