"""Run methods, keep their predictions, score them."""
