"""What both engines of alignment are built from: pyramids, points, starts, the warp, Levenberg-Marquardt's steps."""
