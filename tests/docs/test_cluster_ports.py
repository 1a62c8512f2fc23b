"""A Dask cluster that is started as documented is reached at the addresses that it names, and on loopback."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import check_docs
import pytest
from repository import DOCS, ROOT
from tutorial_pages import environment

psutil: Any = pytest.importorskip("psutil", reason="Dask brings it")
pytest.importorskip("distributed")

COMMANDS = re.compile(r"^(?:dask|openssl) .+", re.MULTILINE)
LOOPBACK = "127.0.0.1"
PATIENCE_S = 120


def documented() -> dict[str, list[str]]:
    """The ``dask`` commands of each block, after the ``openssl`` commands of its page."""
    found = {}
    for page in sorted(DOCS.rglob("*.md")):
        blocks = [COMMANDS.findall("\n".join(block.lines)) for block in check_docs.code_blocks(page)]
        certificates = [line for block in blocks for line in block if line.startswith("openssl")]
        for number, block in enumerate(blocks):
            if dask := [line for line in block if line.startswith("dask")]:
                prepared = certificates if "--tls" in block[0] else []
                found[f"{page.relative_to(ROOT)}#{number}"] = prepared + dask
    return found


BLOCKS = documented()


def test_the_cluster_of_the_documentation_is_found() -> None:
    started = [line.split()[1] for block in BLOCKS.values() for line in block if line.startswith("dask")]
    assert len(BLOCKS) == 3
    assert started == ["scheduler", "worker"] * 3


@pytest.mark.thorough
@pytest.mark.parametrize(("block", "nanny"), [*((block, True) for block in BLOCKS), (next(iter(BLOCKS)), False)])
def test_documented_commands_open_ports_where_they_say(block: str, nanny: bool, tmp_path: Path) -> None:
    if any(line.startswith("openssl") for line in BLOCKS[block]) and shutil.which("openssl") is None:
        pytest.skip("no openssl command to make certificates with")
    scheduler, worker = (here(line) for line in BLOCKS[block] if line.startswith("dask"))
    for line in BLOCKS[block]:
        if line.startswith("openssl"):
            subprocess.run(shlex.split(line), cwd=tmp_path, check=True, capture_output=True)
    with (
        started(scheduler, tmp_path, "Scheduler at:") as scheduling,
        started([*worker, *([] if nanny else ["--no-nanny"])], tmp_path, "Registered to:") as work,
    ):
        assert listening(scheduling) == sorted([host(scheduler), LOOPBACK])
        assert listening(work) == sorted([host(worker), LOOPBACK] + [host(worker)] * nanny)


def here(command: str) -> list[str]:
    """A command with the example's machines as loopback addresses of this process, and with one worker."""
    mine = f"127.{1 + os.getpid() // 250 % 250}.{os.getpid() % 250}."
    command = re.sub(r"\b10\.0\.0\.", mine, command)
    return shlex.split(re.sub(r"--nworkers \d+| 2> \S+ &$", "", command))


def host(command: list[str]) -> str:
    return command[command.index("--host") + 1]


@contextmanager
def started(command: list[str], folder: Path, ready: str) -> Iterator[int]:
    """The process of a command, once it has logged that it is ready."""
    log = folder / f"{command[1]}.log"
    with log.open("wb") as written:
        process = subprocess.Popen(command, cwd=folder, env=environment(folder), stderr=written, stdout=written)
    try:
        until = time.monotonic() + PATIENCE_S
        while ready not in log.read_text():
            assert process.poll() is None, log.read_text()
            assert time.monotonic() < until, log.read_text()
            time.sleep(0.05)
        yield process.pid
    finally:
        for one in family(process.pid):
            one.kill()
        process.wait()


def listening(pid: int) -> list[str]:
    """The address of each port at which a process and its children wait for connections."""
    found = [connection for one in family(pid) for connection in one.net_connections("inet")]
    ports = {connection.laddr for connection in found if connection.status == psutil.CONN_LISTEN}
    return sorted(ip for ip, _ in ports)


def family(pid: int) -> list[Any]:
    parent = psutil.Process(pid)
    return [parent, *parent.children(recursive=True)]
