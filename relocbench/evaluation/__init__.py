"""Running methods, keeping their predictions, and scoring them."""
