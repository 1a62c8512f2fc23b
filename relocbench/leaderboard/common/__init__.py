"""What the leaderboards of all tasks share: text and tables, checks of foreign folders, copies of one dataset."""
