"""The training of LPN and its variants."""
