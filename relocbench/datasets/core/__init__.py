"""A dataset on disk and in memory: its files, schema, fingerprint, images and pairs."""
