"""The model: put yours in place of the stand-in. This is the one file that a new model changes.

The stand-in needs no weights. Written in NumPy, it matches patches and answers a rotation and the direction of the
translation, as a relative-pose network does, and the adapter finds the metres. It is made for views that are alike.
"""

from __future__ import annotations

from collections.abc import Sequence

import stand_in
from adapters import from_direction, points_at
from contract import Answer, Keyframe, View


class Model:
    """Loads the weights once, and answers the queries of one keyframe together.

    Args:
        device: ``cpu``, ``cuda``, ``cuda:1``, ... A network is loaded here and moved to it.
    """

    batch = 8
    """queries of a keyframe that fit into memory at once; relocbench sends 8 at most"""

    def __init__(self, device: str) -> None:
        self.device = "cpu"  # NumPy has no other; a network keeps the one that it is given

    def features(self, view: View) -> stand_in.Features:
        """What can be computed of one image alone, such as the tokens of an encoder: kept for later pairs."""
        return stand_in.features(view.image)

    def track(
        self,
        keyframe: Keyframe,
        of_keyframe: stand_in.Features,
        views: Sequence[View],
        of_views: Sequence[stand_in.Features],
    ) -> list[Answer]:
        """One answer for each view, the same whichever views stand beside it.

        A network stacks ``of_views`` to one tensor and repeats ``of_keyframe``. One that draws random numbers, as for a
        sample of its matches, is seeded for each view.
        """
        return [self._answer(keyframe, of_keyframe, *each) for each in zip(views, of_views, strict=True)]

    def _answer(
        self, keyframe: Keyframe, of_keyframe: stand_in.Features, view: View, of_view: stand_in.Features
    ) -> Answer:
        uv_ref, uv_query = stand_in.matches(of_keyframe, of_view)
        found = stand_in.relative_pose(points_at(keyframe, uv_ref), uv_query, view.camera)
        if found is None:
            return Answer(None, message=f"{len(uv_ref)} matches, too few of them with depth")
        rotation, direction = found
        return from_direction(keyframe, view, uv_ref, uv_query, rotation, direction)
