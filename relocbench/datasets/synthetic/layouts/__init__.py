"""Writers of recordings in the layouts of real data sets."""
