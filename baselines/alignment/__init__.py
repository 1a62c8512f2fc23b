"""Coarse-to-fine image alignment: the pose of a query relative to a reference whose depth is known at some pixels.

``direct`` aligns intensities together with affine brightness parameters (DSO); ``features`` aligns maps of D channels
(GN-Net). Neither imports the other; both use the warp, the normal equations and the Levenberg-Marquardt loop of
``shared``. ``matching`` finds single pixels instead of a pose.
"""
