"""Recordings in the layout of Oxford RobotCar."""
