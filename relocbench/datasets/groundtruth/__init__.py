"""Ground truth across seasons from lidar: poses between the images of two drives of one road, with covariances.

Data flows one way: scans and odometry become ``blocks`` of points, and these become ``submaps``; ``registration`` finds
the pose of each submap of the query relative to the reference by place recognition, ``icp`` and ``verification``; the
``pose_graph`` solves for all poses at once; ``pairs`` accepts or rejects each pair of images; ``depth`` is drawn from
the submaps. ``jobs`` runs all of it, and ``report`` draws pictures of the result.
"""
