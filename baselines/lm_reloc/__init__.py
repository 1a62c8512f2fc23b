"""LM-Reloc: a network that predicts the pose between two images, and the alignment of lm-net's features from there."""
