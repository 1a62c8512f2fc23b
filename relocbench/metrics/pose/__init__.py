"""Metrics of estimated poses: errors, failure policy, recalls and areas, confidence, basin radii."""
