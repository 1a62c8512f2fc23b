"""The command line: what its commands share, and no maths."""

from __future__ import annotations

import errno
import os
import sys

from relocbench.cli.interruption import INTERRUPTED, interruptible, leave, tell_once
from relocbench.errors import USER_ERROR, RelocbenchError, printable

_SURROUNDINGS = {
    getattr(errno, name)
    for name in (
        *("EACCES", "EDQUOT", "EFBIG", "EIO", "EISDIR", "ELOOP", "EMFILE", "ENAMETOOLONG", "ENFILE", "ENODEV"),
        *("ENOSPC", "ENOTDIR", "ENXIO", "EPERM", "EROFS", "ESTALE", "ETXTBSY"),
    )
}
"""what the system refuses: no mistake of the program"""
_PACKAGES = {
    "cv2": "opencv-python-headless",
    "gtsam": "gtsam",
    "itables": "itables",
    "kiss_icp": "kiss-icp",
    "matplotlib": "matplotlib",
    "numba": "numba",
    "open3d": "open3d",
    "pandas": "pandas",
    "plotly": "plotly",
    "pyarrow": "pyarrow",
    "safetensors": "safetensors",
    "scipy": "scipy",
    "torch": "torch",
    "torchvision": "torchvision",
}
"""import name -> package: what a light installation may lack"""
_SYMLINK_LOOP = "Symlink loop from "
"""what Python before 3.13 raises for ELOOP where a path is resolved"""


def main() -> None:
    """Run the command line; a user's mistake is one line and exit status 2, a bug is a traceback."""
    try:
        with interruptible():
            from relocbench.cli.app import run

            status = run()
    except KeyboardInterrupt:
        status = INTERRUPTED
    except RelocbenchError as bad:
        for line in str(bad).split("\n"):
            print(f"relocbench: {line}", file=sys.stderr)
        status = USER_ERROR
    except ModuleNotFoundError as bad:
        package = _PACKAGES.get((bad.name or "").split(".")[0])
        if package is None:
            raise
        print(f"relocbench: needs the package '{package}', which is not installed here", file=sys.stderr)
        status = USER_ERROR
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        status = 1
    except OSError as bad:
        if bad.errno not in _SURROUNDINGS:
            raise
        place = f"{bad.filename}: " if bad.filename else ""
        print(f"relocbench: {printable(f'{place}{bad.strerror}')}", file=sys.stderr)
        status = USER_ERROR
    except RuntimeError as bad:
        if not str(bad).startswith(_SYMLINK_LOOP):
            raise
        print(f"relocbench: {bad}", file=sys.stderr)
        status = USER_ERROR
    if status == INTERRUPTED:
        tell_once()
        leave()
    sys.exit(status)
