"""Where the car drives, with which cameras, in which traffic, and what it knows of its motion."""
