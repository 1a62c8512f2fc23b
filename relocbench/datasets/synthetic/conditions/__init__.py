"""Weather, season and time of day, and their named combinations."""
