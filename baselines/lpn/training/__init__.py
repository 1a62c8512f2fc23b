"""LPN's training: images of known places in, a file of weights out."""
