"""Direct image alignment on intensities, with affine brightness parameters (DSO)."""
