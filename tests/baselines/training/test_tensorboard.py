"""What a training logs is written for TensorBoard as well, where it was requested."""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import pytest
from made_pairs import TINY, MadePairs

from baselines.gn_net.training.presets import gn_net
from relocbench.errors import MethodError
from relocbench.training import TrainingRun, ValidationScores


def _train(run: TrainingRun) -> None:
    values = {"t_auc@0.5m": 0.25}
    scores = ValidationScores(values, {"dry -> wet": values}, {"dry -> wet": 3})
    gn_net().train(MadePairs(), lambda _: scores, {**TINY, "steps": 2, "log_every": 1}, run)


@pytest.mark.thorough
def test_events_hold_what_the_tables_hold(tmp_path: Path) -> None:
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    _train(TrainingRun(tmp_path / "out", workers=0, tensorboard=tmp_path / "events"))
    events = EventAccumulator(str(tmp_path / "events"))
    events.Reload()
    with (tmp_path / "out" / "log.csv").open(newline="") as stream:
        logged = {int(row["step"]): float(row["loss"]) for row in csv.DictReader(stream)}
    written = {event.step: event.value for event in events.Scalars("training/loss")}
    assert written == pytest.approx(logged, rel=1e-5)
    assert len(written) == 2
    assert {"t_auc@0.5m/all", "t_auc@0.5m/dry -> wet"} <= set(events.Tags()["scalars"])


def test_without_the_package_a_training_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.startswith("torch.utils.tensorboard")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "tensorboard", None)
    with pytest.raises(MethodError) as refused:
        _train(TrainingRun(tmp_path / "out", workers=0, tensorboard=tmp_path / "events"))
    assert "'tensorboard'" in str(refused.value)
    assert not (tmp_path / "events").exists()
