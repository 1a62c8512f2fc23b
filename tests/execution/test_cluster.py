"""Work on a Dask cluster: who dies costs what, and every end is one clear line. Real processes on loopback."""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from command_line import relocbench
from dask_processes import DaskProcesses, kill
from refusals import refused
from small_dataset import ACROSS, make_small_dataset
from units_of_work import die_once, square, user_error

from relocbench.datasets.core.pairfile import read_pose_lines
from relocbench.errors import ConfigError, DatasetError, RelocbenchError
from relocbench.execution import Run, Scheduler, cluster, run_units, scheduler

pytest.importorskip("distributed")
pytestmark = pytest.mark.thorough
TRACKERS = "trackers_for_tests"
POLL_S = 0.05
"""how long a run waits between two looks at its workers"""


@pytest.fixture(scope="module")
def module_cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaskProcesses]:
    processes = DaskProcesses(tmp_path_factory.mktemp("dask"))
    yield processes
    processes.close()


@pytest.fixture
def dask(module_cluster: DaskProcesses, monkeypatch: pytest.MonkeyPatch) -> Iterator[DaskProcesses]:
    """A cluster without workers; a machine with much else to do takes long to start them."""
    monkeypatch.setattr(cluster, "WORKER_TIMEOUT_S", 120.0)
    monkeypatch.setattr(scheduler, "SCHEDULER_TIMEOUT", "120s")
    monkeypatch.setattr(cluster, "_POLL_S", POLL_S)
    yield module_cluster
    module_cluster.kill_workers()


def die_at(unit: tuple[str, str]) -> str:
    """Ends its process whenever it is asked about the one unit, and notes every start."""
    name, folder = unit
    with (Path(folder) / "started").open("a") as log:
        log.write(f"{name}\n")
    if name == "deadly":
        kill(os.getpid())
    return name


def die_when_told(unit: tuple[str, str]) -> str:
    """The same, but only once there is a file ``go``: what was done before has then been fetched from the process."""
    name, folder = unit
    while name == "deadly" and not (Path(folder) / "go").exists():
        time.sleep(0.01)
    return die_at(unit)


def kill_once(unit: tuple[int, int, str]) -> int:
    """Unit 3 kills a process that it is told of."""
    index, pid, _ = unit
    if index == 3:
        kill(pid)
    return index


def where(dask: DaskProcesses) -> Scheduler:
    return Scheduler(address=str(dask.file))


def test_a_worker_that_dies_in_the_middle_of_a_unit_costs_a_retry(dask: DaskProcesses, tmp_path: Path) -> None:
    dask.add_workers(2)
    units = [str(tmp_path / name) for name in ("a", "die", "b", "c", "d", "e")]
    results = dict(run_units(die_once, units, Run(scheduler=where(dask))))
    assert [results[i] for i in range(6)] == ["a", "die", "b", "c", "d", "e"]
    assert dask.alive == 1
    with refused(DatasetError, "file.txt", 3):
        list(run_units(user_error, [3], Run(scheduler=where(dask))))
    assert dask.alive == 1


def test_a_worker_that_dies_with_a_result_that_nobody_fetched_costs_a_retry(
    dask: DaskProcesses, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Dask itself would wait for such a result without end."""
    monkeypatch.setattr(cluster, "ANSWER_TIMEOUT_S", 3600.0)
    take = cluster._Dispatch._collect_results
    deaths: list[list[str]] = []

    def die_before(self: cluster._Dispatch[int, int], keys: list[str]) -> Iterator[tuple[int, int]]:
        if keys and not deaths:
            deaths.append(keys)
            dask.kill_workers()
            dask.add_workers(1)
        yield from take(self, keys)

    monkeypatch.setattr(cluster._Dispatch, "_collect_results", die_before)
    dask.add_workers(1)
    assert dict(run_units(square, [1, 2, 3], Run(scheduler=where(dask)))) == {0: 1, 1: 4, 2: 9}
    assert deaths


def test_a_unit_that_kills_every_worker_is_lost_and_its_neighbours_are_not(dask: DaskProcesses, tmp_path: Path) -> None:
    dask.add_workers(3)
    units = [(name, str(tmp_path)) for name in ("a", "deadly", "b", "c", "d")]
    given_up: list[str] = []

    def give_up(unit: tuple[str, str]) -> str:
        given_up.append(unit[0])
        return "lost"

    results = dict(cluster.run_on_cluster(die_at, units, where(dask), give_up))
    assert [results[i] for i in range(5)] == ["a", "lost", "b", "c", "d"]
    assert given_up == ["deadly"]
    assert (tmp_path / "started").read_text().split().count("deadly") == 2
    assert dask.alive == 1


def test_with_no_worker_left_the_run_ends_and_says_how_to_go_on(
    dask: DaskProcesses, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster, "WORKER_TIMEOUT_S", 0.2)
    with refused(RelocbenchError, "", None, "0.2 s", "0 of 2"):
        list(run_units(square, [1, 2], Run(scheduler=where(dask))))
    monkeypatch.setattr(cluster, "WORKER_TIMEOUT_S", 120.0)
    dask.add_workers(1)
    units = [(name, str(tmp_path)) for name in ("a", "b", "deadly", "c", "d")]
    results = run_units(die_when_told, units, Run(scheduler=where(dask)))
    assert sorted([next(results), next(results)]) == [(0, "a"), (1, "b")]
    monkeypatch.setattr(cluster, "WORKER_TIMEOUT_S", 0.2)
    (tmp_path / "go").touch()
    with refused(RelocbenchError, "", None, "0.2 s", "2 of 5"):
        list(results)


def test_a_scheduler_that_goes_away_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "WORKER_TIMEOUT_S", 120.0)
    monkeypatch.setattr(cluster, "_POLL_S", POLL_S)
    processes = DaskProcesses(tmp_path)
    try:
        processes.add_workers(1)
        units = [(index, processes.scheduler, "") for index in range(8)]
        with refused(RelocbenchError, "", None, "of 8 units"):
            list(run_units(kill_once, units, Run(scheduler=where(processes))))
    finally:
        processes.close()


def test_a_worker_that_does_not_see_the_folders_is_refused(dask: DaskProcesses, tmp_path: Path) -> None:
    """What a path below /proc/self means depends on the process, as a path of the same name on two machines."""
    hasty = tmp_path.with_name(f"{tmp_path.name}.py")
    hasty.write_text("import relocbench.execution.handshake\nrelocbench.execution.handshake._LOOKS = 1\n")
    dask.add_workers(1, cwd=tmp_path, preload=hasty)  # it does not look again for a file that may come later
    mine = Path(f"/proc/self/task/{os.getpid()}")
    with refused(ConfigError, mine):
        list(run_units(square, [1, 2], Run(scheduler=where(dask).with_shared_folders(tmp_path, mine))))
    here = Path("/proc/self/cwd")
    assert here.resolve() != tmp_path
    before = sorted(here.iterdir())
    with refused(ConfigError, here):
        list(run_units(square, [1, 2], Run(scheduler=where(dask).with_shared_folders(here))))
    assert sorted(here.iterdir()) == before
    results = dict(run_units(square, [1, 2], Run(scheduler=where(dask).with_shared_folders(tmp_path, tmp_path))))
    assert results == {0: 1, 1: 4}
    assert not list(tmp_path.iterdir())
    made = make_small_dataset(tmp_path.with_name(f"{tmp_path.name}-data"))
    seen = Path(f"/proc/self/task/{os.getpid()}") / "root" / made.root.relative_to("/")
    ended = relocbench(
        "evaluate", "-d", seen, "-m", "identity", "--scheduler", dask.address, "-o", tmp_path / "results"
    )
    assert ended.status == 2
    assert str(seen) in ended.complaint


def test_a_worker_with_another_version_is_refused(dask: DaskProcesses, tmp_path: Path) -> None:
    older = tmp_path / "older.py"
    older.write_text("from relocbench import version\nversion.__version__ = '0.0.1'\n")
    dask.add_workers(1, preload=older)
    with refused(ConfigError, "", None, "relocbench 0.0.1"):
        list(run_units(square, [1, 2], Run(scheduler=where(dask))))


def test_a_pair_that_kills_its_worker_costs_that_pair_as_it_does_locally(dask: DaskProcesses, tmp_path: Path) -> None:
    made = make_small_dataset(tmp_path / "data")
    deadly = made.pair_set(ACROSS).pairs[0].query_timestamp_ns
    command = ["evaluate", "-d", made.root, "-m", f"m={TRACKERS}:Logging", "--set", f"log={tmp_path / 'log'}"]
    command += ["--set", f"dies_at={deadly}", "--pair-set", ACROSS, "--quiet"]
    assert [p.query_timestamp_ns for p in made.pair_set(ACROSS).pairs].count(deadly) == 1
    dask.add_workers(3)
    apart = relocbench(*command, "--out", tmp_path / "apart", "--scheduler", dask.file)
    assert apart.status == 0
    assert apart.err.startswith("m: crashed on 1 of 7 pairs, counted as failures; ")
    assert apart.err.count("\n") == 1, "a pair that broke is a result, which --quiet does not hide"
    assert relocbench(*command, "--out", tmp_path / "local", "-j", 2).status == 0
    found = [next((tmp_path / out).glob(f"*/m/{ACROSS}.txt")) for out in ("apart", "local")]
    assert found[0].read_bytes() == found[1].read_bytes()
    answered = {line.query_timestamp_ns for line in read_pose_lines(found[0])}
    assert answered == {p.query_timestamp_ns for p in made.pair_set(ACROSS).pairs} - {deadly}


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """``ca.pem``, and ``cert.pem`` with ``key.pem`` that it signed."""
    if shutil.which("openssl") is None:
        pytest.skip("no openssl command to make certificates with")
    folder = tmp_path_factory.mktemp("certificates")

    def openssl(*arguments: str) -> None:
        subprocess.run(["openssl", *arguments], cwd=folder, check=True, capture_output=True)

    new = ("-newkey", "rsa:2048", "-nodes", "-days", "2")
    openssl("req", "-x509", *new, "-keyout", "ca.key", "-out", "ca.pem", "-subj", "/CN=authority of a test")
    openssl("req", *new, "-keyout", "key.pem", "-out", "cert.csr", "-subj", "/CN=127.0.0.1")
    signing = ("-CA", "ca.pem", "-CAkey", "ca.key", "-CAcreateserial", "-days", "2")
    openssl("x509", "-req", "-in", "cert.csr", *signing, "-out", "cert.pem")
    return folder


def test_a_cluster_with_tls_takes_who_holds_a_certificate_and_no_other(
    certificates: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster, "WORKER_TIMEOUT_S", 120.0)
    ca, cert, key = (certificates / f"{name}.pem" for name in ("ca", "cert", "key"))
    processes = DaskProcesses(tmp_path, certificates)
    try:
        assert processes.address.startswith("tls://")
        processes.add_workers(1)
        known = Scheduler(address=processes.address, tls_ca=ca, tls_cert=cert, tls_key=key)
        assert dict(run_units(square, [1, 2, 3], Run(scheduler=known))) == {0: 1, 1: 4, 2: 9}
        monkeypatch.setattr(scheduler, "SCHEDULER_TIMEOUT", "0.5s")  # whoever is refused tries until then
        with refused(ConfigError, "", None, "--scheduler-tls-ca"):
            list(run_units(square, [1, 2], Run(scheduler=Scheduler(address=processes.address))))
        plain = processes.address.replace("tls://", "tcp://")
        with refused(ConfigError, "", None, plain):
            list(run_units(square, [1, 2], Run(scheduler=Scheduler(address=plain))))
        command = "openssl req -x509 -newkey rsa:2048 -nodes -keyout o.key -out o.pem -subj /CN=stranger"
        subprocess.run(command.split(), cwd=tmp_path, check=True, capture_output=True)
        other = Scheduler(processes.address, ca, tmp_path / "o.pem", tmp_path / "o.key")
        with refused(ConfigError, "", None, processes.address):
            list(run_units(square, [1, 2], Run(scheduler=other)))
    finally:
        processes.close()
