"""Where work runs: order-free, bounded, surviving a worker's death."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from dask_processes import LOOPBACK
from killing import is_running
from refusals import refused
from units_of_work import count_alive, die, die_once, end_at_once, environment, square, user_error

from relocbench.errors import ConfigError, DatasetError, RelocbenchError
from relocbench.execution import Run, Scheduler, chunks, kept_workers, run_units, scheduler

PAGES = {"dashboard_address": LOOPBACK, "worker_dashboard_address": LOOPBACK}


@pytest.mark.parametrize("workers", [1, 2])
def test_every_unit_is_done_once_and_comes_with_its_index(workers: int) -> None:
    results = dict(run_units(square, list(range(7)), Run(workers)))
    assert results == {i: i * i for i in range(7)}


def test_workers_are_other_processes_with_one_thread_each() -> None:
    before = os.environ.get("OMP_NUM_THREADS")
    results = [result for _, result in run_units(environment, [0, 1, 2, 3], Run(2))]
    assert all(pid != os.getpid() and threads == "1" for pid, threads in results)
    assert os.environ.get("OMP_NUM_THREADS") == before


def test_a_worker_that_dies_costs_its_unit_a_retry(tmp_path: Path) -> None:
    units = [str(tmp_path / name) for name in ("a", "die", "b", "c", "d")]
    results = dict(run_units(die_once, units, Run(2)))
    assert [results[i] for i in range(5)] == ["a", "die", "b", "c", "d"]


def test_workers_that_end_while_they_start_are_reported_with_a_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("relocbench.execution.worker_process.serve", end_at_once)
    with pytest.raises(RelocbenchError) as told:
        list(run_units(square, [1, 2, 3], Run(2)))
    assert "2 worker processes ended while they started (exit status 3)" in str(told.value)
    for remedy in ("memory", "--workers 1", "standard error", "__main__"):
        assert remedy in str(told.value)


@pytest.mark.thorough
def test_kept_workers_serve_call_after_call_until_one_dies(tmp_path: Path) -> None:
    def processes() -> set[int]:
        return {pid for _, (pid, _) in run_units(environment, range(8), Run(2))}

    with kept_workers():
        first = processes()
        with kept_workers():
            assert processes() <= first
        units = [str(tmp_path / name) for name in ("a", "die", "b")]
        assert sorted(run_units(die_once, units, Run(2))) == [(0, "a"), (1, "die"), (2, "b")]
        second = processes()
        assert len(first - second) <= 1, "only the one that died is replaced"
        with refused(DatasetError, "file.txt"):
            list(run_units(user_error, range(3), Run(2)))
        assert processes() <= second
    assert not any(is_running(pid) for pid in first | second)
    assert not processes() & second


def test_workers_end_with_a_job_that_is_killed(tmp_path: Path) -> None:
    program = (
        "import sys; from units_of_work import tell_and_sleep; from relocbench.execution import Run, run_units\n"
        "if __name__ == '__main__': list(run_units(tell_and_sleep, [sys.argv[1]] * 2, Run(2)))"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    script = tmp_path / "job.py"
    script.write_text(program)
    job = subprocess.Popen([sys.executable, str(script), str(tmp_path)], env=environment)
    until = time.monotonic() + 600
    while len(told := [int(path.name) for path in tmp_path.glob("[0-9]*")]) < 2:
        assert time.monotonic() < until
        assert job.poll() is None, "the job ended before its workers had begun"
        time.sleep(0.05)
    job.kill()
    job.wait()
    until = time.monotonic() + 600
    while any(is_running(pid) for pid in told):
        assert time.monotonic() < until, "workers outlive their job"
        time.sleep(0.05)


@pytest.mark.thorough
def test_a_unit_that_kills_every_worker_is_named() -> None:
    with refused(RelocbenchError, "", None, "2 times", "SIGKILL"):
        list(run_units(die, [1, 2], Run(2)))


@pytest.mark.parametrize("workers", [1, 2])
def test_a_users_mistake_keeps_its_file_and_line_across_processes(workers: int) -> None:
    with refused(DatasetError, "file.txt", 3) as caught:
        list(run_units(user_error, [3, 3], Run(workers)))
    assert isinstance(caught.value, DatasetError)
    assert caught.value.line == 3


def test_only_a_bounded_number_of_units_is_in_flight(tmp_path: Path) -> None:
    for seen, _ in enumerate(run_units(count_alive, [str(tmp_path)] * 40, Run(2)), start=1):
        started = len(list(tmp_path.iterdir()))
        assert started <= seen + 2 * 2 + 2


def test_no_scheduler_is_one_clear_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scheduler, "SCHEDULER_TIMEOUT", "0.2s")
    with refused(ConfigError, "", None, "tcp://127.0.0.1:9"):
        list(run_units(square, [1, 2], Run(scheduler=Scheduler(address="tcp://127.0.0.1:9"))))


def test_a_dask_cluster_gives_the_same_results() -> None:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, processes=False, **PAGES) as cluster:
        results = dict(run_units(square, list(range(9)), Run(scheduler=Scheduler(address=cluster.scheduler_address))))
    assert results == {i: i * i for i in range(9)}


def test_workers_with_several_threads_are_refused() -> None:
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(n_workers=1, threads_per_worker=2, processes=False, **PAGES) as cluster,
        pytest.raises(ConfigError, match="--nthreads 1"),
    ):
        list(run_units(square, [1, 2], Run(scheduler=Scheduler(address=cluster.scheduler_address))))


def test_chunks_keep_order_and_size() -> None:
    rng = np.random.default_rng(0)
    for n in rng.integers(0, 20, 10):
        parts = list(chunks(range(n), 4))
        assert [x for part in parts for x in part] == list(range(n))
        assert all(len(part) == 4 for part in parts[:-1])
