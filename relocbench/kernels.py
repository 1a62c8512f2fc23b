"""Compiled kernels: ``njit``, and the folder where Numba caches compiled code, one for each state of the sources.

Numba's cache checks only the file of a compiled function. If a function of another file that is compiled into it
changes, in an update or during development, the old code keeps running: pictures and poses would depend on what was
compiled when. The folder is therefore named by a digest of all files with kernels and of the modules that they import.
A user who sets ``NUMBA_CACHE_DIR`` has to take care of this instead.

Modules with kernels import ``njit`` from here, so that the folder is set before the first kernel is defined.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import time
from collections.abc import Iterable, Sequence
from pathlib import Path

import numba

_VARIABLE = "NUMBA_CACHE_DIR"
_IMPORT = re.compile(rb"^(?:from|import) ([\w.]+)", re.MULTILINE)
_UNUSED_S = 30 * 86400
_PACKAGES = ("relocbench", "baselines")


def use_kernel_cache() -> None:
    """Point Numba at the folder of these sources, unless the user has chosen one."""
    if _VARIABLE in os.environ:
        return
    root = Path(__file__).resolve().parents[1]
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "relocbench" / "kernels"
    folder = home / kernel_digest(root, _PACKAGES)
    os.environ[_VARIABLE] = str(folder)
    numba.config.reload_config()
    try:
        os.utime(folder)  # in use
    except OSError:
        _forget(home)


def kernel_digest(root: Path, packages: Sequence[str]) -> str:
    """A hexadecimal digest that changes with every file of the packages under ``root`` that holds a kernel, and with
    every module that such a file imports by name."""
    files = sorted(path for package in packages for path in (root / package).rglob("*.py"))
    texts = {path: path.read_bytes() for path in files}
    with_kernels = {path for path, text in texts.items() if b"njit" in text}
    taken = {
        path for kernel in with_kernels for name in _imports(texts[kernel], packages) for path in _files(root, name)
    }
    digest = hashlib.sha256()
    for path in sorted(with_kernels | (taken & texts.keys())):
        digest.update(str(path.relative_to(root)).encode())
        digest.update(hashlib.sha256(texts[path]).digest())
    return digest.hexdigest()[:16]


def _imports(text: bytes, packages: Sequence[str]) -> Iterable[str]:
    names = (name.decode() for name in _IMPORT.findall(text))
    return (name for name in names if name.split(".")[0] in packages)


def _files(root: Path, name: str) -> tuple[Path, Path]:
    path = root.joinpath(*name.split("."))
    return path.with_suffix(".py"), path / "__init__.py"


def _forget(home: Path) -> None:
    """Remove the folders of sources that have not been used for a month."""
    try:
        old = [f for f in home.iterdir() if f.is_dir() and time.time() - f.stat().st_mtime > _UNUSED_S]
    except OSError:
        return
    for folder in old:
        shutil.rmtree(folder, ignore_errors=True)


use_kernel_cache()
njit = numba.njit
