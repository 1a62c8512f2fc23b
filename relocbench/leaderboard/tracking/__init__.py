"""The leaderboard of trackers: results, tables, page and files."""
