"""Readers of the formats of point clouds; :func:`~relocbench.datasets.sensors.cloud_files.read_cloud` chooses one."""
