"""Ask retrievers about the tasks of a retrieval set, keep their rankings, score them."""
