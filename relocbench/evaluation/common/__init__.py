"""What the evaluations of all tasks share: options, the folders of results, and what is read from them."""
