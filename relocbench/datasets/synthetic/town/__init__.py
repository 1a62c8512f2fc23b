"""Districts: streets, houses, plants and cars as triangles."""
