"""What the leaderboards of all tasks share: text and tables, checks of untrusted folders, copies of one dataset."""
