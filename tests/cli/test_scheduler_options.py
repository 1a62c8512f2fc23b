"""``--scheduler``: what is wrong with where work is to run is one line, before a cluster is asked."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_line import relocbench
from kitti_wall import write_kitti_recording
from small_dataset import make_small_dataset

from relocbench.execution import scheduler

pytest.importorskip("distributed")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--scheduler-tls-ca", "ca.pem"], "--scheduler-tls-ca has no effect without --scheduler"),
        (["--scheduler", "tcp://127.0.0.1:9", "--scheduler-tls-ca", "ca.pem"], "certificates are for a tls:// address"),
        (["--scheduler", "tls://127.0.0.1:9"], "tls://127.0.0.1:9 needs --scheduler-tls-ca"),
        (
            ["--scheduler", "tls://127.0.0.1:9", "--scheduler-tls-ca", "none.pem"],
            "none.pem: missing; expected a PEM file",
        ),
        (
            ["--scheduler", "tls://h:9", "--scheduler-tls-ca", "words", "--scheduler-tls-cert", "words"],
            "these certificates cannot be used for TLS",
        ),
        (["--scheduler", "words"], "words: holds no address; expected the JSON file"),
        (["--scheduler", "none.json"], "none.json: missing; expected the JSON file"),
        (["--scheduler", "nowhere"], "no Dask scheduler answers at nowhere"),
    ],
)
def test_what_is_wrong_with_the_options_of_a_scheduler_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: list[str], said: str
) -> None:
    monkeypatch.setattr(scheduler, "SCHEDULER_TIMEOUT", "0.2s")
    monkeypatch.chdir(tmp_path)
    make_small_dataset(tmp_path / "data")
    (tmp_path / "words").write_text("words\n")
    ended = relocbench("evaluate", "-d", "data", "-m", "identity", "--quiet", *options)
    assert ended.status == 2
    assert said in ended.complaint


def test_a_configuration_file_says_where_work_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scheduler, "SCHEDULER_TIMEOUT", "1s")
    make_small_dataset(tmp_path / "data")
    written = tmp_path / "options.yaml"
    written.write_text("methods: [identity]\nscheduler: {address: 'tls://h:1', tls_ca: none.pem}\n")
    ended = relocbench("evaluate", "-d", tmp_path / "data", "--config", written, "--out", tmp_path / "results")
    assert "none.pem: missing" in ended.complaint
    written.write_text("workers: 2\nscheduler: tls://h:1\nmax_disparity: 64\n")
    recording = write_kitti_recording(tmp_path / "recording")
    ended = relocbench("build-dataset", "kitti", recording, "--config", written, "--out", tmp_path / "wall", "--quiet")
    assert "tls://h:1 needs --scheduler-tls-ca" in ended.complaint
    written.write_text("scheduler: {adress: 'tcp://h:1'}\n")
    ended = relocbench("build-dataset", "synthetic", "--config", written, "--out", tmp_path / "other")
    assert f"{written}:1: " in ended.complaint
    assert not (tmp_path / "other").exists()
