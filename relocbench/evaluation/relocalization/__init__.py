"""The full pipeline: a retriever ranks keyframes, a tracker runs against the best, one answer is kept."""
