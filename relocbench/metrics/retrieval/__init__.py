"""Metrics of retrieval: relevance, ranking, recall and average precision, chance level, checks of published tables."""
