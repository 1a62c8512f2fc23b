"""Where the process of a method runs: it sees no other process, finds some folders empty, and can write only to a few.

Two ways are tried: the kernel's namespaces, which need no privileges on most systems, and ``bubblewrap``, which some
systems allow more than others. Where neither works, as on macOS and in many containers, a process runs as it is.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from relocbench.errors import ConfigError
from relocbench.execution import namespaces

NAMESPACES, BUBBLEWRAP, NONE = "namespaces", "bubblewrap", "none"
NO_SANDBOX = "--sandbox required: neither namespaces nor bubblewrap work on this system"
_PATIENCE_S = 10.0


@dataclass(frozen=True)
class Sandbox:
    """How processes of a method are kept from everything else."""

    kind: str = NONE
    """``namespaces``, ``bubblewrap`` or ``none``; empty for the one that works where the process is started"""
    hidden: tuple[Path, ...] = ()
    """folders that they find empty, but for what they may write to"""
    required: bool = False
    """whether nothing may be started where there is none"""

    @property
    def exists(self) -> bool:
        """Whether there is one where processes are started. Raises ConfigError where there must be."""
        found = (self.kind or working_sandbox()) != NONE
        if self.required and not found:
            raise ConfigError(NO_SANDBOX)
        return found

    def start(
        self, words: Sequence[str], writable: Sequence[Path], *, pass_fds: Sequence[int] = (), **options: Any
    ) -> subprocess.Popen[Any]:
        """Start a command inside.

        Environment and working folder are passed on. The exit status is that of the command, or 128 and the number of
        the signal that ended it. It ends with the process that started it, and all that it has started with it. What
        is hidden and writable is in no argument, since those of process 1 can be read inside.

        Args:
            writable: existing folders that the command may write to.
            pass_fds, options: of ``subprocess.Popen``.
        """
        kind = self.kind or working_sandbox()
        writes = [str(path.resolve()) for path in writable]
        resolved = {path.resolve() for path in self.hidden if path.is_dir()}
        hides = sorted(str(path) for path in resolved if resolved.isdisjoint(path.parents))
        if kind == NAMESPACES:
            spec = json.dumps({"parent": os.getpid(), "writable": writes, "hidden": hides})
            words = ["env", f"{namespaces.SPEC}={spec}", sys.executable, "-I", "-S", namespaces.__file__, *words]
        if kind == BUBBLEWRAP:
            seen = ["--ro-bind", "/", "/", "--dev-bind", "/dev", "/dev", "--tmpfs", "/dev/shm", "--proc", "/proc"]
            system = [f"/proc/{name}" for name in namespaces.OF_THE_SYSTEM if Path(f"/proc/{name}").exists()]
            seen += [word for path in system for word in ("--ro-bind", path, path)]
            seen += [word for path in namespaces.block_devices() for word in ("--dev-bind", "/dev/null", path)]
            seen += [word for path in hides for word in ("--tmpfs", path)]
            seen += [word for path in writes for word in ("--bind", path, path)]
            seen += [word for path in hides for word in ("--remount-ro", path)]
            apart = ["--unshare-user", "--unshare-pid", "--unshare-ipc", "--cap-drop", "ALL"]
            ends = ["--die-with-parent", "--new-session"]
            seen += [*apart, *ends, "--chdir", str(Path.cwd())]
            with os.fdopen(os.memfd_create("bubblewrap"), "wb") as file:
                file.write(b"".join(os.fsencode(word) + b"\0" for word in seen))
                file.seek(0)
                words = ["bwrap", "--args", str(file.fileno()), *words]
                return subprocess.Popen(words, pass_fds=(*pass_fds, file.fileno()), **options)
        return subprocess.Popen(words, pass_fds=pass_fds, **options)


@cache
def working_sandbox() -> str:
    """The kind of sandbox that works on this system: ``namespaces``, ``bubblewrap`` or ``none``."""
    if sys.platform != "linux":
        return NONE
    return next((kind for kind in (NAMESPACES, BUBBLEWRAP) if _works(kind)), NONE)


def _works(kind: str) -> bool:
    if kind == BUBBLEWRAP and shutil.which("bwrap") is None:
        return False
    silent: dict[str, Any] = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    try:
        with Sandbox(kind).start(["true"], [], **silent) as process:
            try:
                return process.wait(_PATIENCE_S) == 0
            finally:
                process.kill()
    except (OSError, subprocess.TimeoutExpired):
        return False
