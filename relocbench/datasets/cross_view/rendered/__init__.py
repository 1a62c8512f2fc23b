"""A cross-view set rendered from procedural towns."""
