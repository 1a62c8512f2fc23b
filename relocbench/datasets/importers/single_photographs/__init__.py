"""Single photographs, each of which becomes pairs by a made-up motion in front of a made-up surface."""
