"""Direct image alignment on intensities, with an affine change of brightness (DSO)."""
