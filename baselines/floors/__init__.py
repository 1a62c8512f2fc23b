"""Baseline retrievers that learn nothing, which a trained one should surpass."""

from baselines.floors.bag_of_words import OrbBagOfWords
from baselines.floors.colour_histogram import ColourHistogram
from baselines.floors.random_order import RandomOrder

__all__ = ["ColourHistogram", "OrbBagOfWords", "RandomOrder"]
