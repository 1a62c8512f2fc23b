"""Building datasets and recordings: planning, distributing the rendering, and exact ground truth."""
