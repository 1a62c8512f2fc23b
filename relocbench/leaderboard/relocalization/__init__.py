"""The leaderboard of chains: board, page and files."""
