"""Which images are paired, and what a pair's truth says of single pixels."""
