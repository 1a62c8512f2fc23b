"""The leaderboard of retrievers: board, page and files."""
