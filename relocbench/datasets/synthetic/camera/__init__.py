"""A camera of its own for a drive: from the light of the scene to the grey levels of the stored image."""
