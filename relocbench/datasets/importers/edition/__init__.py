"""Kind ``edition``: a named, versioned benchmark of rendered districts, by tiers of difficulty."""
