"""What a worker keeps in memory for the next images and scans: of each kind the latest, so that there is only one."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from typing import Any, Protocol, TypeVar

from relocbench.datasets.synthetic.drives.traffic import MovingCar

Value = TypeVar("Value")
_latest: dict[str, tuple[Hashable, Any]] = {}
"""of this process: kind -> (key, value)"""


class Reusable(Protocol):
    """A renderer, such as :class:`relocbench.datasets.synthetic.renderer.render.Renderer`."""

    @property
    def surroundings(self) -> Any:
        """What another renderer of the same town with other moving cars can reuse."""
        ...


AnyRenderer = TypeVar("AnyRenderer", bound=Reusable)


def latest(kind: str, key: Hashable, make: Callable[[], Value]) -> Value:
    """The latest of a kind, if it was made for this key; the one before is let go before another is made."""
    if kind not in _latest or _latest[kind][0] != key:
        _latest.pop(kind, None)
        _latest[kind] = key, make()
    value: Value = _latest[kind][1]
    return value


def forget_all() -> None:
    """Let go what is kept."""
    _latest.clear()


def latest_renderer(
    scene: Hashable, moving: Sequence[MovingCar], make: Callable[[Sequence[MovingCar], Any], AnyRenderer]
) -> AnyRenderer:
    """The renderer of a district in a condition (``scene``) with the moving cars of one moment.

    ``make`` gets the moving cars, and the surroundings of the scene without them or None.
    """

    def made() -> AnyRenderer:
        if not moving:
            return make((), None)
        return make(moving, latest("surroundings", scene, lambda: make((), None).surroundings))

    positions = tuple((T_world_car.tobytes(), variant) for T_world_car, variant in moving)
    return latest("renderer", (scene, positions), made)
