"""Networks of the package kornia, which is optional."""

from __future__ import annotations

from typing import Any

from relocbench.errors import MethodError


def from_kornia(name: str, network: str) -> Any:
    """What kornia's ``kornia.feature`` has by a name; nothing is downloaded.

    Args:
        network: what the user calls it, for the message.

    Raises:
        MethodError: kornia is not installed.
    """
    try:
        import kornia.feature
    except ModuleNotFoundError as bad:
        if bad.name is None or bad.name.partition(".")[0] != "kornia":
            raise
        raise MethodError(f"{network} needs the package kornia: pip install 'relocbench[learned]'") from bad
    return getattr(kornia.feature, name)
