"""What is rendered and recorded, by whom, and the exact truth of it."""
