"""The losses of GN-Net and LM-Reloc, by which the features are trained; each has a module of its own."""
