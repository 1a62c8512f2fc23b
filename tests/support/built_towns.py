"""What streets are rendered of is made once a run: the district, its patterns, its sky and the light in its streets."""

from __future__ import annotations

import functools
import hashlib
import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import ParamSpec, TypeVar

import pytest
from built_once import FOLDER, once

from relocbench.datasets.synthetic.jobs import recording_set, scenes
from relocbench.datasets.synthetic.renderer import render
from relocbench.datasets.synthetic.town.raycast import Scene

P = ParamSpec("P")
T = TypeVar("T")


def keep_towns(patch: pytest.MonkeyPatch) -> None:
    """Let jobs in this process take from the folder of the run what one of its processes has made before.

    It takes seconds to make for each street and condition. What tests call by itself, and what jobs in processes of
    their own make, is made anew.
    """
    for module, name in (
        (scenes, "make_district"),
        (recording_set, "make_district"),
        (render, "bake"),
        (render, "make_sky"),
        (render, "make_skylight"),
    ):
        patch.setattr(module, name, _once_a_run(getattr(module, name)))


def _once_a_run(make: Callable[P, T]) -> Callable[P, T]:
    @functools.wraps(make)
    def kept(*args: P.args, **kwargs: P.kwargs) -> T:
        given = [one for one in args if not isinstance(one, Scene)]  # a scene follows from the mesh beside it
        key = pickle.dumps((make.__module__, make.__qualname__, given, kwargs))
        made = Path(os.environ[FOLDER]) / hashlib.sha256(key).hexdigest()[:16]
        once(made, lambda path: path.write_bytes(pickle.dumps(make(*args, **kwargs))))
        value: T = pickle.loads(made.read_bytes())
        return value

    return kept
