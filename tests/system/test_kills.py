"""Jobs that are killed again and again at points of their work end as if nobody had."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_line import relocbench
from kill_campaign import Job, campaign
from killing import Fault, run_until_killed, run_with_fault
from kitti_wall import write_kitti_recording
from small_dataset import make_small_dataset


@pytest.mark.thorough
def test_a_build_killed_in_its_work_ends_with_the_bytes_of_one_that_was_not(tmp_path: Path) -> None:
    """The short version of ``benchmarks/truth/kills.py``, whose jobs have workers as well."""
    recording = write_kitti_recording(tmp_path / "recording")
    options = ("--correspondences", 100, "--max-disparity", 64, "-j", 1, "-q")
    build = ("python", "-m", "relocbench", "build-dataset", "kitti", recording, *options)
    outcome = campaign(Job("build", lambda out: [*build, "-o", out], has_workers=False), 1, tmp_path / "trees")
    assert outcome.landed == 1
    assert not outcome.differing
    assert not outcome.broken


@pytest.mark.thorough
@pytest.mark.parametrize("record", ["dataset", "run", "scores"])
def test_an_evaluation_killed_while_it_writes_a_record_leaves_nothing_unfinished_once_it_is_done(
    tmp_path: Path, record: str
) -> None:
    out = tmp_path / "out"
    dataset = make_small_dataset(tmp_path / "small", frames=2, size=(64, 48))
    command = ("evaluate", "-d", dataset.root, "-m", "identity", "-j", 0, "-o", out)
    run_until_killed(["python", "-m", "relocbench", *command], Fault(rf"/{record}\.yaml$", 1), tmp_path / "trace")
    assert [path.name.split(".")[1] for path in out.rglob(".*.part*")] == [record]
    assert relocbench(*command).status == 0
    assert not list(out.rglob(".*.part*"))


WRITER = """
import sys
from pathlib import Path
from relocbench.files import write_text
for name in "abc":
    write_text(Path(sys.argv[1]) / name, name)
"""


def test_a_fault_point_is_between_the_writing_of_a_file_and_its_final_name(tmp_path: Path) -> None:
    run_until_killed(["python", "-c", WRITER, tmp_path / "out"], Fault(r"/out/[abc]$", 2), tmp_path / "trace")
    names = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert names[1:] == ["a"]
    assert names[0].startswith(".b.")
    assert (tmp_path / "out" / names[0]).read_text() == "b"


def test_a_fault_point_that_is_not_reached_is_told(tmp_path: Path) -> None:
    command = ["python", "-c", WRITER, tmp_path / "out"]
    ended = run_with_fault(command, Fault("/out/", 4), tmp_path / "trace")
    assert (ended.status, ended.landed, len(ended.events)) == (0, None, 3)
    with pytest.raises(AssertionError, match="was not reached; 3 events"):
        run_until_killed(command, Fault("/out/", 4), tmp_path / "again")
