"""Points by the cube of space that they lie in."""
