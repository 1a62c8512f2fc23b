"""Photo collections: images that are named rather than timed, each with a camera of its own."""
