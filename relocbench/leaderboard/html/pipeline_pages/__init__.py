"""The pages of pipelines of a retriever and a tracker: a dataset's, and that of one query with its keyframes."""
