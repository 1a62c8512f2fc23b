"""The identity method."""

from __future__ import annotations

import numpy as np
from answer_contract import fault_of

from baselines.identity import Identity
from relocbench.geometry import Camera, se3_exp
from relocbench.tracking import Query, Reference, Tracker


def test_identity_answers_the_identity_whatever_it_is_shown() -> None:
    camera = Camera("pinhole", 8, 6, 5, 5, 4, 3)
    image = np.zeros((6, 8), np.uint8)
    method = Identity()
    assert isinstance(method, Tracker)
    reference, query = Reference("r", 0, image, camera), Query("q", 1, image, camera)
    for prior in (None, se3_exp([1, 2, 3, 0.1, 0.2, 0.3])):
        result = method.track(reference, query, prior)
        assert fault_of(result) is None
        np.testing.assert_array_equal(result.T_query_ref, np.eye(4))


def test_answers_do_not_share_memory() -> None:
    camera = Camera("pinhole", 8, 6, 5, 5, 4, 3)
    image = np.zeros((6, 8), np.uint8)
    method, reference, query = Identity(), Reference("r", 0, image, camera), Query("q", 1, image, camera)
    first = method.track(reference, query)
    assert first.T_query_ref is not None
    first.T_query_ref[0, 3] = 9.0
    np.testing.assert_array_equal(method.track(reference, query).T_query_ref, np.eye(4))
