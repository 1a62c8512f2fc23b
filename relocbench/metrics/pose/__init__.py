"""Metrics of estimated poses: errors, failure policy, recalls and areas, confidence, matching quality, basin radii."""
