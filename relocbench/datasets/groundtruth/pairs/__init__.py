"""Which images of two drives are paired, and why a pair is refused."""
