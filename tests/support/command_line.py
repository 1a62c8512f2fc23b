"""Run the command line in this process: ``from command_line import relocbench``."""

from __future__ import annotations

import contextlib
import io
import json
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

from relocbench.cli import main


@dataclass(frozen=True)
class Outcome:
    """What a command left on its two streams, and its exit status."""

    status: int
    out: str
    err: str

    @property
    def complaint(self) -> str:
        """The one line of a user's mistake."""
        lines = [line for line in self.err.splitlines() if line.strip()]
        assert len(lines) == 1, f"expected one line, got:\n{self.err}"
        return lines[0]

    def keep(self, path: Path) -> None:
        """Write what :meth:`kept` reads."""
        path.write_text(json.dumps(asdict(self)))

    @staticmethod
    def kept(path: Path) -> Outcome:
        return Outcome(**json.loads(path.read_text()))


def relocbench(*arguments: object) -> Outcome:
    """``relocbench ARGUMENTS`` without a terminal."""
    out, err = io.StringIO(), io.StringIO()
    before = sys.argv
    sys.argv = ["relocbench", *map(str, arguments)]
    status = 0
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            main()
    except SystemExit as stop:
        status = stop.code if isinstance(stop.code, int) else int(stop.code is not None)
    finally:
        sys.argv = before
    return Outcome(status, out.getvalue(), err.getvalue())
