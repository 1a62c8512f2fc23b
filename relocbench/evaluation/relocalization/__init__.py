"""Both halves in a row: a retriever ranks keyframes, a tracker is asked against the best, the surest answer is kept."""
