"""The leaderboard of trackers: results, tables, plots, page and files."""
