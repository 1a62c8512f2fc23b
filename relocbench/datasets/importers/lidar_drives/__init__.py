"""What importers of published lidar datasets share: the build, options, conditions, tables and maps."""
