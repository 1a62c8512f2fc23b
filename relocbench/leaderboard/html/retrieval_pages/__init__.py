"""The pages of retrievers: a set's, with table and curves, and that of one query with the images it retrieved."""
