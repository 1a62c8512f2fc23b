"""Two drives brought together: registered, kept on disk, solved."""
