"""Procedural districts: streets, houses, plants and cars as triangle meshes."""
