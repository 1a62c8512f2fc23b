"""The clock of the poses, by the images: at which time after an image's own its camera had the pose that it shows."""
