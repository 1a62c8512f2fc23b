"""Statistics of correlated pairs: how many independent pairs they are worth, confidence intervals, ranks."""
