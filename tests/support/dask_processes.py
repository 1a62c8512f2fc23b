"""A Dask scheduler and workers as processes of their own: ``from dask_processes import DaskProcesses``.

Importing Dask takes seconds on a busy machine: one process does it and then forks the scheduler and every worker.
"""

from __future__ import annotations

import asyncio
import json
import os
import runpy
import signal
import subprocess
import sys
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

LOOPBACK = "127.0.0.1:0"
"""where Dask serves its pages; without an address it serves them to the network, with ``dashboard=False`` too"""


class DaskProcesses:
    """A scheduler on loopback; workers are added and killed one by one.

    Args:
        folder: for the scheduler file and the log.
        certificates: a folder with ``ca.pem``, ``cert.pem`` and ``key.pem``, for TLS.
        environment: variables of all these processes that are added or replaced.
    """

    def __init__(
        self, folder: Path, certificates: Path | None = None, environment: Mapping[str, str] | None = None
    ) -> None:
        self.file = folder / "scheduler.json"
        self.workers: list[int] = []
        arguments = [sys.executable, str(Path(__file__)), str(folder), str(certificates or "")]
        self._log = (folder / "log").open("ab")
        self._forker = subprocess.Popen(
            arguments,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            cwd=folder,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path)), **(environment or {})},
        )
        self.scheduler = self._fork()
        while not self.file.exists() or not self.file.read_text().endswith("}"):
            assert is_running(self.scheduler), (folder / "log").read_text()
            os.sched_yield()

    @property
    def address(self) -> str:
        return str(json.loads(self.file.read_text())["address"])

    def add_workers(self, count: int, cwd: Path | None = None, preload: Path | None = None) -> None:
        """Workers with one thread and no nanny: one that dies stays dead."""
        for _ in range(count):
            self.workers.append(self._fork(cwd=str(cwd or ""), preload=str(preload or "")))

    @property
    def alive(self) -> int:
        return sum(map(is_running, self.workers))

    def kill_workers(self) -> None:
        """All of them, at once."""
        for pid in self.workers:
            with suppress(ProcessLookupError):
                kill(pid)
        self.workers = []

    def close(self) -> None:
        self.kill_workers()
        with suppress(ProcessLookupError):
            kill(self.scheduler)
        self._forker.kill()
        self._forker.communicate()
        self._log.close()

    def _fork(self, **what: str) -> int:
        assert self._forker.stdin is not None
        assert self._forker.stdout is not None
        self._forker.stdin.write(json.dumps(what).encode() + b"\n")
        self._forker.stdin.flush()
        return int(self._forker.stdout.readline())


def kill(pid: int) -> None:
    """As the system ends a process that is out of memory."""
    os.kill(pid, signal.SIGKILL)


def is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def main(folder: Path, certificates: str) -> None:
    """Fork the scheduler for the first line on standard input, a worker for each that follows; answer with its id."""
    from distributed import Scheduler, Worker
    from distributed.security import Security

    security = Security()
    if certificates:
        ca, cert, key = (f"{certificates}/{name}.pem" for name in ("ca", "cert", "key"))
        roles = {
            f"tls_{role}_{what}": path
            for role in ("scheduler", "worker")
            for what, path in (("cert", cert), ("key", key))
        }
        security = Security(tls_ca_file=ca, require_encryption=True, **roles)
    file = folder / "scheduler.json"

    def schedule() -> Awaitable[Any]:
        protocol = "tls" if certificates else "tcp"
        return Scheduler(
            protocol=protocol,
            host="127.0.0.1",
            port=0,
            dashboard=False,
            dashboard_address=LOOPBACK,
            security=security,
            scheduler_file=str(file),
        )

    def work() -> Awaitable[Any]:
        return Worker(
            scheduler_file=str(file),
            nthreads=1,
            memory_limit=0,
            host="127.0.0.1",
            dashboard=False,
            dashboard_address=LOOPBACK,
            security=security,
            local_directory=str(folder),
        )

    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # the system forgets children by itself
    role = schedule
    for line in sys.stdin:
        what = json.loads(line)
        pid = os.fork()
        if pid == 0:
            _serve(role, what.get("cwd"), what.get("preload"))
        print(pid, flush=True)
        role = work


def _serve(role: Callable[[], Awaitable[Any]], cwd: str | None, preload: str | None) -> None:
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    os.dup2(os.open(os.devnull, os.O_RDWR), 0)
    os.dup2(2, 1)
    if cwd:
        os.chdir(cwd)
    if preload:
        runpy.run_path(preload)

    async def run() -> None:
        server = await role()
        await server.finished()

    try:
        asyncio.run(run())
    finally:
        os._exit(0)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
