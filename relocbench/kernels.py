"""``njit`` for compiled kernels, with a Numba cache that is renewed whenever their sources change.

Numba's own cache only checks the file that defines a compiled function. When that function calls one from another file
and the other file changes, Numba keeps running the old code, and results would depend on what was compiled when. Here
the cache folder is therefore named by a digest of all files with kernels and of the modules they import. A user who
sets ``NUMBA_CACHE_DIR`` gives up this protection.

Every module with kernels must import ``njit`` from here, so that the folder is set before its first kernel is defined.
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
_SHARED = "RELOCBENCH_CACHE_HOME"
"""names the user's caches in a method's process, whose own home and caches are private"""
_IMPORT = re.compile(rb"^(?:from|import) ([\w.]+)", re.MULTILINE)
_UNUSED_S = 30 * 86400
_PACKAGES = ("relocbench", "baselines")


def use_kernel_cache() -> None:
    """Point Numba at the cache folder of the current sources, unless the user has chosen one."""
    if _VARIABLE in os.environ:
        return
    root = Path(__file__).resolve().parents[1]
    home = Path(os.environ.get(_SHARED) or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    home = home / "relocbench" / "kernels"
    folder = home / kernel_digest(root, _PACKAGES)
    os.environ[_VARIABLE] = str(folder)
    numba.config.reload_config()
    try:
        os.utime(folder)  # marks it as in use
    except OSError:
        _remove_unused(home)


def kernel_digest(root: Path, packages: Sequence[str]) -> str:
    """Digest of all files with kernels in the packages under ``root`` and of the modules that these files import."""
    files = sorted(path for package in packages for path in (root / package).rglob("*.py"))
    texts = {path: path.read_bytes() for path in files}
    with_kernels = {path for path, text in texts.items() if b"njit" in text}
    imported = {
        path
        for kernel in with_kernels
        for name in _imported_modules(texts[kernel], packages)
        for path in _module_files(root, name)
    }
    digest = hashlib.sha256()
    for path in sorted(with_kernels | (imported & texts.keys())):
        digest.update(str(path.relative_to(root)).encode())
        digest.update(hashlib.sha256(texts[path]).digest())
    return digest.hexdigest()[:16]


def _imported_modules(text: bytes, packages: Sequence[str]) -> Iterable[str]:
    names = (name.decode() for name in _IMPORT.findall(text))
    return (name for name in names if name.split(".")[0] in packages)


def _module_files(root: Path, name: str) -> tuple[Path, Path]:
    path = root.joinpath(*name.split("."))
    return path.with_suffix(".py"), path / "__init__.py"


def _remove_unused(home: Path) -> None:
    """Remove cache folders that have not been used for a month."""
    try:
        old = [f for f in home.iterdir() if f.is_dir() and time.time() - f.stat().st_mtime > _UNUSED_S]
    except OSError:
        return
    for folder in old:
        shutil.rmtree(folder, ignore_errors=True)


use_kernel_cache()
njit = numba.njit
