"""Running trackers on pairs, importing and exporting predictions, scoring them, and checking methods and results."""
