"""What ``log.csv`` and ``validation.csv`` say, for TensorBoard as well."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from relocbench.errors import MethodError


class EventFile:
    """Scalars by step in an event file, which ``tensorboard --logdir FOLDER`` draws.

    Args:
        folder: of the event files; made where it is missing. A training that goes on adds another file.
        step: after which the training goes on; scalars of later steps in earlier files are no longer drawn.

    Raises:
        MethodError: the package ``tensorboard`` is not installed.
    """

    def __init__(self, folder: Path, step: int) -> None:
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ImportError:
            raise MethodError(
                "--tensorboard needs the package 'tensorboard', which is not installed here "
                "(the extra 'tensorboard' brings it)"
            ) from None
        self._writer = SummaryWriter(str(folder), purge_step=step + 1)

    def add(self, step: int, values: Mapping[str, float]) -> None:
        """Write scalars by their tags, such as ``training/loss``, and leave them on disk."""
        for tag, value in values.items():
            self._writer.add_scalar(tag, value, step)
        self._writer.flush()

    def close(self) -> None:
        """Close the file; nothing is added any more."""
        self._writer.close()
