"""LPN (Local Pattern Network) and its variants: places retrieved by parts of an image, across views."""
