"""Folders that one process of a method alone uses, and that are gone afterwards, however their owner ends.

A method finds its home, its caches and its temporary files in such a folder, so that it cannot leave notes there for
another method or a later run. An owner holds a lock on its folder for as long as it lives; a folder without one was
left behind by a process that was killed, and is removed by whoever makes the next one. All folders of a user lie in
one, which a sandbox hides, so that no method finds those of others that run at the same time.
"""

from __future__ import annotations

import fcntl
import os
import secrets
import shutil
import stat
import subprocess
import tempfile
import weakref
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from relocbench.errors import RelocbenchError

_PREFIX = "relocbench-methods-"
_SHARED_CACHES = {
    "TORCH_HOME": "torch",
    "HF_HOME": "huggingface",
    "MPLCONFIGDIR": "matplotlib",
}
"""variable -> folder in the user's cache: what a method has downloaded is not downloaded again for each process"""
KERNEL_CACHE = "RELOCBENCH_CACHE_HOME"
"""variable that says in which folder of caches compiled kernels of relocbench are"""
_KERNELS = (KERNEL_CACHE, "NUMBA_CACHE_DIR")


class ScratchFolder:
    """A new, empty folder among the system's temporary ones, which is removed with this object or by a later one.

    Raises:
        RelocbenchError: the folder in which it should lie is another user's.
    """

    def __init__(self) -> None:
        sweep()
        base, made = _new_folder()
        descriptor = os.open(made, os.O_RDONLY | os.O_DIRECTORY)
        with suppress(OSError):  # a file system without locks, on which nothing is swept either
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        # It gets the name by which it is found once it is locked, so that it is never taken for one without an owner.
        self.path = made.rename(base / secrets.token_hex(8))
        self._finalizer = weakref.finalize(self, _remove, self.path, descriptor)

    def environment(self) -> dict[str, str]:
        """The variables of this process, with home, caches and temporary files in this folder.

        Caches of weights that were downloaded stay shared, as do all caches whose own variable the user has set.
        """
        home, temporary = self.path / "home", self.path / "tmp"
        for folder in (home, temporary):
            folder.mkdir(exist_ok=True)
        return {
            **_shared_caches(),
            **os.environ,
            "HOME": str(home),
            **dict.fromkeys(("TMPDIR", "TMP", "TEMP"), str(temporary)),
            "XDG_CACHE_HOME": str(home / ".cache"),
            "XDG_CONFIG_HOME": str(home / ".config"),
            "XDG_DATA_HOME": str(home / ".local" / "share"),
            "XDG_STATE_HOME": str(home / ".local" / "state"),
        }

    def remove(self) -> None:
        """Remove the folder and what is in it."""
        self._finalizer()


def _new_folder() -> tuple[Path, Path]:
    """The folder of all folders of this user, and a new one in it under a name that is not swept."""
    base = _base()
    while True:
        with suppress(FileExistsError):
            base.mkdir(mode=0o700)
        with suppress(FileNotFoundError):  # its last user has just removed it
            if not _is_own_folder(base):
                raise RelocbenchError(f"{base}: not a folder of this user; remove it, or name another place by TMPDIR")
            return base, Path(tempfile.mkdtemp(prefix=".", dir=base))


def _base() -> Path:
    return Path(tempfile.gettempdir()) / f"{_PREFIX}{os.geteuid()}"


def _is_own_folder(path: Path) -> bool:
    about = path.lstat()
    return stat.S_ISDIR(about.st_mode) and about.st_uid == os.geteuid()


def shared_folders(environment: Mapping[str, str], kernels: bool = True) -> list[Path]:
    """The folders of caches that a method with these variables shares with others, made where they are missing.

    Args:
        kernels: also those of compiled kernels, which are executed by whoever reads them.
    """
    named = {name: Path(value) for name, value in environment.items() if name in _SHARED_CACHES or _is_cache(name)}
    if KERNEL_CACHE in environment:
        named[KERNEL_CACHE] = Path(environment[KERNEL_CACHE]) / "relocbench"
    if not kernels:
        named = {name: path for name, path in named.items() if name not in _KERNELS}
    made = []
    for path in named.values():
        with suppress(OSError):
            path.mkdir(parents=True, exist_ok=True)
            made.append(path)
    return made


def _is_cache(variable: str) -> bool:
    return variable.endswith(("_CACHE_DIR", "_CACHE_PATH"))


def _shared_caches() -> dict[str, str]:
    """The caches of the user that a method goes on using, by variable."""
    shared = {}
    users = Path("~")
    with suppress(RuntimeError):  # a user without a home
        users = users.expanduser()
        shared["CUDA_CACHE_PATH"] = str(users / ".nv" / "ComputeCache")
    caches = os.environ.get("XDG_CACHE_HOME") or (str(users / ".cache") if shared else "")
    if caches:
        shared |= {name: str(Path(caches) / folder) for name, folder in _SHARED_CACHES.items()}
        shared[KERNEL_CACHE] = caches
    return shared


def sweep() -> None:
    """Remove the folders whose owners are gone."""
    base = _base()
    with suppress(OSError):
        if not _is_own_folder(base):
            return
    for path in base.glob("[!.]*"):
        with suppress(OSError):
            descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            try:
                if os.fstat(descriptor).st_uid == os.geteuid():
                    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)  # an owner that lives holds it
                    _remove_tree(path)
            finally:
                os.close(descriptor)


def _remove(path: Path, descriptor: int) -> None:
    _remove_tree(path)
    os.close(descriptor)
    with suppress(OSError):  # others are in it
        path.parent.rmdir()


def _remove_tree(path: Path) -> None:
    """Remove what a method has left, also folders in folders, a thousand deep, and those that it has closed to all."""
    with suppress(RecursionError):
        shutil.rmtree(path, ignore_errors=True)
    if path.exists():
        for words in (["chmod", "-R", "u+rwx"], ["rm", "-rf"]):
            subprocess.run([*words, "--", path], check=False, stderr=subprocess.DEVNULL)
