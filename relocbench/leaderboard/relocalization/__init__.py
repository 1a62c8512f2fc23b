"""The leaderboard of pipelines: board, page and files."""
