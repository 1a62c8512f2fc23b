"""The page of one pair: its images, and the keyframe as the query would see it at any pose."""
