"""Whether a registration is right: evidence for and against it."""
