"""The tables of a results folder, each stated once as a record whose fields are its columns."""
