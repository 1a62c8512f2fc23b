"""The alignment of two drives: registrations, which are kept on disk, and the pose graph."""
