"""LPN (Local Pattern Network) and its variants: cross-view retrieval of places by parts of an image."""
