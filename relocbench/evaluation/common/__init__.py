"""What the evaluations of all tasks share: workers, checked answers, results folders and their tables."""
