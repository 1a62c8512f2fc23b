"""Chains: a retriever ranks keyframes, a tracker runs against the best of them, and its surest answer is kept."""
