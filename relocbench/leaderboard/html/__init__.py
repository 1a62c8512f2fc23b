"""The results as a site of static pages: it opens from a disk, without a server and without the network."""
