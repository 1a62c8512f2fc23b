"""What the system refuses, or does oddly: one line each, nothing lost, and the same command goes on afterwards."""

from __future__ import annotations

import errno
import json
import os
import resource
import shutil
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType

import numpy as np
import pytest
from command_line import Outcome, relocbench
from small_dataset import ACROSS, CAMERA, make_small_dataset

from baselines.files import write_whole
from baselines.training.checkpoint import Checkpoint, save_checkpoint
from relocbench.datasets.core import images
from relocbench.datasets.core.layout import DatasetLayout
from relocbench.datasets.pairs.correspondence_file import read_correspondences, write_correspondences
from relocbench.errors import DatasetError
from relocbench.evaluation.isolation.journal import journal_entries, open_journal
from relocbench.files import plain_file, read_text, sha256_file, write_text

_HANG_S = 600
"""a safety net: whoever waits for a pipe waits for ever"""


@pytest.fixture(autouse=True)
def no_hang() -> Iterator[None]:
    def stop(number: int, frame: FrameType | None) -> None:
        raise AssertionError(f"still waiting after {_HANG_S} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(_HANG_S)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset, never changed, with results."""
    root = tmp_path_factory.mktemp("made")
    make_small_dataset(root / "data", correspondences=20)
    assert evaluate(root / "data", root / "results").status == 0
    return root


@pytest.fixture
def data(made: Path, tmp_path: Path) -> Path:
    shutil.copytree(made / "data", tmp_path / "data")
    return tmp_path / "data"


def evaluate(data: Path, out: Path, *more: object) -> Outcome:
    return relocbench("evaluate", "-d", data, "-m", "identity", "--out", out, "-j", 1, "--quiet", *more)


def answers(out: Path) -> bytes:
    return next(out.glob(f"*/identity/{ACROSS}.txt")).read_bytes()


# Symbolic links that lead to themselves.


@pytest.mark.thorough
@pytest.mark.parametrize(
    "arguments",
    [
        ["evaluate", "-d", "LOOP", "-m", "identity"],
        ["evaluate", "-d", "data", "-m", "identity", "--out", "LOOP"],
        ["evaluate", "-m", "identity", "--config", "LOOP"],
        ["evaluate", "-d", "data", "--predictions", "LOOP", "--out", "results"],
        ["probe", "-d", "data", "-m", "dso", "--out", "LOOP"],
        ["inspect", "LOOP"],
        ["inspect", "data", "--json", "--pictures", "LOOP"],
        ["validate", "LOOP"],
        ["export", "-d", "data", "--format", "tum", "--out", "LOOP"],
        ["leaderboard", "LOOP", "--out", "board"],
        ["leaderboard", "results", "--out", "LOOP"],
        ["demo", "--out", "LOOP", "--quiet"],
        ["build-dataset", "generic", "LOOP", "--out", "new"],
        ["build-dataset", "kitti", "LOOP", "--out", "new"],
        ["build-dataset", "tum-rgbd", "LOOP", "--out", "new"],
        ["build-dataset", "four-seasons", "LOOP", "--out", "new"],
        ["build-dataset", "robotcar", "LOOP", "data", "--out", "new"],
        ["build-dataset", "synthetic", "--out", "LOOP"],
        ["build-dataset", "synthetic", "--recording", "kitti", "--out", "LOOP"],
        ["build-dataset", "cross-view", "--out", "LOOP"],
        ["preview", "--condition", "Sunny", "--size", "64", "--quiet", "--out", "LOOP/x.png"],
        ["train", "gn-net", "-d", "LOOP", "--out", "trained"],
        ["train", "gn-net", "-d", "data", "--out", "LOOP"],
    ],
    ids=" ".join,
)
def test_a_link_to_itself_is_one_line_wherever_it_is_given(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "data").symlink_to(made / "data")
    (tmp_path / "loop").symlink_to("loop")
    ended = relocbench(*[a.replace("LOOP", "loop") for a in arguments])
    assert ended.status == 2
    assert "loop" in ended.complaint
    assert {path.name for path in tmp_path.iterdir()} <= {"data", "loop"}


@pytest.mark.thorough
@pytest.mark.parametrize("inside", ["dataset.yaml", "manifest.csv", "IMAGE", "DEPTH", "POSES", "PAIRS"])
def test_a_link_to_itself_in_a_dataset_is_one_line(data: Path, tmp_path: Path, inside: str) -> None:
    path = part(data, inside)
    path.unlink()
    path.symlink_to(path.name)
    ended = evaluate(data, tmp_path / "results")
    assert ended.status == 2
    # A dataset without its last file is one whose build was not finished.
    assert str(data if inside == "dataset.yaml" else path) in ended.complaint
    assert not list(tmp_path.glob("results/*/*/*.txt"))


def part(data: Path, name: str) -> Path:
    summer = DatasetLayout(data).traversal("summer")
    named = {
        "IMAGE": next((data / "traversals/summer/images" / CAMERA).iterdir()),
        "DEPTH": next((data / "traversals/summer/depth" / CAMERA).iterdir()),
        "POSES": summer.poses,
        "PAIRS": DatasetLayout(data).pair_file(ACROSS),
        "CORRESPONDENCES": DatasetLayout(data).correspondence_file(ACROSS),
    }
    return named.get(name, data / name)


# Pipes, sockets and devices where a file is expected.


@pytest.mark.thorough
@pytest.mark.parametrize("inside", ["dataset.yaml", "manifest.csv", "IMAGE", "DEPTH", "POSES", "PAIRS"])
def test_a_pipe_in_a_dataset_is_refused_and_not_waited_for(data: Path, tmp_path: Path, inside: str) -> None:
    path = part(data, inside)
    path.unlink()
    os.mkfifo(path)
    ended = evaluate(data, tmp_path / "results")
    assert ended.status == 2
    assert str(path) in ended.complaint
    assert relocbench("validate", data).status in (1, 2)


@pytest.mark.thorough
def test_a_device_among_results_is_refused_and_not_read_without_end(data: Path, tmp_path: Path) -> None:
    out = tmp_path / "results"
    assert evaluate(data, out).status == 0
    path = next(out.glob(f"*/identity/{ACROSS}.txt"))
    path.unlink()
    path.symlink_to("/dev/zero")
    ended = relocbench("validate", out)
    assert ended.status == 2
    assert f"{path.name}: is a pipe, a socket or a device" in ended.complaint
    ended = relocbench("leaderboard", out, "--out", tmp_path / "board")
    assert ended.status == 2
    assert f"{path.name}: is a link that leads out of the results" in ended.complaint


@pytest.mark.thorough
def test_a_pipe_given_as_a_file_is_refused(made: Path, tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.yaml"
    os.mkfifo(pipe)
    for arguments in (
        ["evaluate", "--config", pipe],
        ["evaluate", "-d", made / "data", "-m", "gn-net", "--set", f"gn-net.weights={pipe}", "--out", tmp_path / "r"],
        ["build-dataset", "synthetic", "--config", pipe, "--out", tmp_path / "town"],
        ["train", "gn-net", "-d", made / "data", "--config", pipe, "--out", tmp_path / "trained"],
    ):
        ended = relocbench(*arguments)
        assert ended.status == 2
        assert str(pipe) in ended.complaint


def test_devices_and_sockets_are_no_files(tmp_path: Path) -> None:
    bound = tmp_path / "socket"
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(bound))
        for path in (Path("/dev/zero"), Path("/dev/tty"), bound):
            for read in (sha256_file, images.read_image, lambda p: read_text(p, "text"), read_correspondences):
                with pytest.raises(Exception, match="is a pipe, a socket or a device; expected") as caught:
                    read(path)
                assert str(path) in str(caught.value)
    assert relocbench("evaluate", "--config", "/dev/zero").complaint.startswith("relocbench: /dev/zero: is a pipe")


def test_a_pipe_in_a_recording_is_refused(tmp_path: Path) -> None:
    folder = tmp_path / "summer"
    (folder / "images").mkdir(parents=True)
    (folder / "camera.yaml").write_text("model: pinhole\nwidth: 8\nheight: 8\nparams: [8, 8, 4, 4]\n")
    (folder / "poses.txt").write_text("0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n")
    for name in ("0.png", "1000000000.png"):
        os.mkfifo(folder / "images" / name)
    ended = relocbench("build-dataset", "generic", folder, "--out", tmp_path / "new", "--quiet")
    assert ended.status == 2
    assert "summer" in ended.complaint


# A disk, a quota or a limit that is full.


@contextmanager
def limit(kind: int, value: int) -> Iterator[None]:
    """A limit of this process, put back afterwards."""
    before = resource.getrlimit(kind)
    resource.setrlimit(kind, (value, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(kind, before)


def _noise(*shape: int) -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)


def _write_npz(path: Path) -> None:
    from relocbench.files import atomic_write

    with atomic_write(path, "wb") as stream:
        np.savez(stream, a=_noise(100_000))


def _write_parquet(path: Path) -> None:
    from relocbench.datasets.pairs.correspondences import PairCorrespondences
    from relocbench.datasets.pairs.measures import PairMeasures

    n, rng = 4000, np.random.default_rng(0)
    pixels, yes = rng.random((n, 2)), np.ones(n, dtype=bool)
    found = PairCorrespondences(pixels, rng.random(n), pixels, yes, np.zeros(n, dtype=np.int8), PairMeasures(0.5))
    write_correspondences(path, [((k, k), found) for k in range(4)])


def _write_checkpoint(path: Path) -> None:
    import torch

    net = {"w": torch.zeros(50_000)}
    save_checkpoint(path, Checkpoint({}, 1, net, {}, None, {}, 0, 0.0, None, []))


def _write_figure(path: Path) -> None:
    from matplotlib.figure import Figure

    from relocbench.files import atomic_write

    figure = Figure()
    figure.add_subplot().imshow(_noise(300, 300))
    with atomic_write(path, "wb") as stream:
        figure.savefig(stream, format="png")


WRITERS: dict[str, Callable[[Path], None]] = {
    "text": lambda path: write_text(path, "line\n" * 10_000),
    "image.png": lambda path: images.write_image(path, _noise(200, 200)),
    "depth.png": lambda path: images.write_depth(path, np.random.default_rng(0).uniform(1, 50, (200, 200))),
    "blocks.npz": _write_npz,
    "pairs.parquet": _write_parquet,
    "checkpoint.pt": _write_checkpoint,
    "curve.png": _write_figure,
    "weights": lambda path: write_whole(path, bytes(50_000)),
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_file_beyond_the_limit_is_named_and_nothing_of_it_is_left(tmp_path: Path, name: str) -> None:
    """Python asks the system not to kill it (SIGXFSZ); libraries that write by themselves must come to the same."""
    WRITERS[name](tmp_path / "warm-up")
    (tmp_path / "warm-up").unlink()
    with limit(resource.RLIMIT_FSIZE, 4096), pytest.raises(OSError, match="too large") as caught:
        WRITERS[name](tmp_path / name)
    assert caught.value.errno == errno.EFBIG
    assert caught.value.filename == str(tmp_path / name)
    assert not list(tmp_path.iterdir())
    WRITERS[name](tmp_path / name)
    assert (tmp_path / name).stat().st_size > 4096


@pytest.mark.thorough
def test_a_run_that_meets_a_limit_of_file_size_says_which_file_and_goes_on_later(made: Path, tmp_path: Path) -> None:
    with limit(resource.RLIMIT_FSIZE, 1024):
        ended = evaluate(made / "data", tmp_path / "results")
    assert ended.status == 2
    assert str(tmp_path / "results") in ended.complaint
    assert "File too large" in ended.complaint
    assert evaluate(made / "data", tmp_path / "results").status == 0
    assert answers(tmp_path / "results") == answers(made / "results")


@pytest.mark.thorough
def test_a_full_disk_is_named_by_its_file_and_the_run_goes_on_when_there_is_room(made: Path, tmp_path: Path) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=12k", "tmpfs", disk], capture_output=True, check=False
    )
    if mounted.returncode:
        pytest.skip(f"no small disk can be mounted: {mounted.stderr.decode().strip()}")
    try:
        ended = evaluate(made / "data", disk / "results")
        assert ended.status == 2
        assert str(disk / "results") in ended.complaint
        assert "No space left on device" in ended.complaint
        subprocess.run(["mount", "-o", "remount,size=2m", disk], check=True)
        assert evaluate(made / "data", disk / "results").status == 0
        assert answers(disk / "results") == answers(made / "results")
    finally:
        subprocess.run(["umount", "-l", disk], check=True)


@pytest.mark.thorough
def test_no_more_open_files_is_one_line(made: Path, tmp_path: Path) -> None:
    highest = max(int(name) for name in os.listdir("/proc/self/fd"))  # noqa: PTH208  a folder of numbers
    with limit(resource.RLIMIT_NOFILE, highest + 1):
        taken: list[int] = []
        with suppress(OSError):
            while True:
                taken.append(os.open("/dev/null", os.O_RDONLY))
        ended = evaluate(made / "data", tmp_path / "results")
        for descriptor in taken:
            os.close(descriptor)
    assert ended.status == 2
    assert "Too many open files" in ended.complaint
    assert evaluate(made / "data", tmp_path / "results").status == 0


@pytest.mark.thorough
def test_a_program_that_is_being_written_costs_its_pairs_and_is_told(made: Path, tmp_path: Path) -> None:
    program = tmp_path / "tracker"
    shutil.copy2("/bin/true", program)
    with program.open("ab"):
        ended = relocbench(
            *("evaluate", "-d", made / "data", "-m", f"p=subprocess:{program}"),
            *("--out", tmp_path / "results", "-j", 1, "--json"),
        )
    assert ended.status == 0  # what a method cannot do costs its pairs
    told = json.loads(ended.out)["broken"][0]["message"]
    assert f"cannot start '{program}' (Text file busy)" in told


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["ESTALE", "EIO", "ENXIO", "EFBIG", "EDQUOT", "ENFILE", "EROFS", "ENODEV", "ETXTBSY"])
def test_what_the_system_refuses_is_one_line_that_names_the_file(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """Such errors need a broken disk or a server that is gone: the lowest call that Python offers raises them here."""
    number = getattr(errno, name)
    real = os.fsync

    def fsync(descriptor: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "fsync", fsync)
    ended = relocbench("leaderboard", made / "results", "--out", tmp_path / "board", "--quiet")
    assert ended.status == 2
    assert ended.complaint == f"relocbench: {tmp_path / 'board' / 'leaderboard.csv'}: {os.strerror(number)}"
    assert not (tmp_path / "board").exists()
    monkeypatch.setattr(os, "fsync", real)
    assert relocbench("leaderboard", made / "results", "--out", tmp_path / "board", "-q").status == 0


# Clocks that stand still or go backwards.


@pytest.fixture(params=["stands still", "goes backwards"])
def odd_clock(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    now = 1_600_000_000_000_000_000

    def nanoseconds() -> int:
        nonlocal now
        now -= 10**9 if request.param == "goes backwards" else 0
        return now

    for name in ("time_ns", "perf_counter_ns", "monotonic_ns"):
        monkeypatch.setattr(time, name, nanoseconds)
    for name in ("time", "perf_counter", "monotonic"):
        monkeypatch.setattr(time, name, lambda: nanoseconds() / 1e9)


@pytest.mark.thorough
def test_an_odd_clock_changes_no_answer(made: Path, tmp_path: Path, odd_clock: None) -> None:
    ended = relocbench("evaluate", "-d", made / "data", "-m", "identity", "--out", tmp_path / "results", "-j", 1)
    assert ended.status == 0
    assert answers(tmp_path / "results") == answers(made / "results")
    assert relocbench("leaderboard", tmp_path / "results", "--out", tmp_path / "board").status == 0


def test_two_journals_of_one_moment_are_two_files(tmp_path: Path, odd_clock: None) -> None:
    with open_journal(tmp_path) as first, open_journal(tmp_path) as second:
        first.write('{"key": [1, 2]}\n')
        second.write('{"key": [3, 4]}\n')
    assert sorted(entry["key"] for entry in journal_entries(tmp_path)) == [(1, 2), (3, 4)]


def test_a_missing_file_is_left_to_whoever_opens_it(tmp_path: Path) -> None:
    assert plain_file(tmp_path / "none", "a file", DatasetError) == tmp_path / "none"
