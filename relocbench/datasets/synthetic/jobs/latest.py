"""What a worker keeps in memory for the next images and scans: of each kind the latest, so that there is only one."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from typing import Any, Protocol, Self, TypeVar

from relocbench.datasets.synthetic.town.mesh import Mesh
from relocbench.datasets.synthetic.town.moving import Moving, moving_mesh

Value = TypeVar("Value")
_latest: dict[str, tuple[Hashable, Any]] = {}
"""of this process: kind -> (key, value)"""


class Reusable(Protocol):
    """A renderer, such as :class:`relocbench.datasets.synthetic.renderer.render.Renderer`."""

    def with_moving(self, mesh: Mesh) -> Self:
        """A renderer of the same scene with what moves at one moment, in place of the one made before."""
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


def forget_renderer() -> None:
    """Let go the renderer, which a worker that goes on to pairs needs no more."""
    _latest.pop("renderer", None)


def latest_renderer(scene: Hashable, moving: Sequence[Moving], make: Callable[[], AnyRenderer]) -> AnyRenderer:
    """The renderer of a district in a condition (``scene``) with what moves at one moment.

    ``make`` makes that of the scene without anything that moves.
    """

    def made() -> tuple[AnyRenderer, dict[Hashable, AnyRenderer]]:
        # What moves is let go with the scene, since its renderer holds the scene's arrays.
        return make(), {}

    still, moments = latest("renderer", scene, made)
    if not moving:
        return still
    moment = tuple((T_world_thing.tobytes(), *look) for T_world_thing, *look in moving)
    if moment not in moments:
        moments.clear()
        moments[moment] = still.with_moving(moving_mesh(moving))
    return moments[moment]
