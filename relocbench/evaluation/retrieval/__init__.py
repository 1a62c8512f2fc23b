"""Running retrievers on the tasks of a retrieval set, keeping their rankings, and scoring them."""
