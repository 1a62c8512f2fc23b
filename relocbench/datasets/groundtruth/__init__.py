"""Ground truth across seasons, from lidar: what a recording offers, and how its drives are brought together.

Data flows one way: ``recording`` (what was measured) -> ``blocks`` (points along the odometry, piece by piece) ->
``submaps`` -> ``registration`` (one drive against another) -> ``verification`` -> ``graph`` (all at once, with
covariances) -> ``outcome`` (each pair accepted or rejected) -> ``depth``.
"""
