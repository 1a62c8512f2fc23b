"""Resampling statistics: confidence intervals, paired differences and ranks from a block bootstrap."""
