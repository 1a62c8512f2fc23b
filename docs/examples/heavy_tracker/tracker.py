"""A tracker around a large model, in an environment of its own: it speaks relocbench's line protocol.

``model.py`` holds the model. Here is what every model needs: it is loaded once, on a GPU if there is one; what is
computed of an image is kept for the next pairs; queries are answered in batches; whatever the model raises costs one
pair; and what it prints goes to standard error, since standard output belongs to the protocol. Try it with

    relocbench check-method "subprocess:PYTHON docs/examples/heavy_tracker/tracker.py"

where PYTHON is the interpreter of the model's environment.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import sys
import time
import traceback
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from typing import Any, TextIO

import numpy as np
from contract import Answer, Keyframe, View, read_keyframe, read_view
from model import Model

from relocbench.geometry import transform_to_tq


class FeatureCache:
    """The features of the images that were used last, by the digests that relocbench sends as their keys.

    Args:
        most: number of images whose features are kept.
    """

    def __init__(self, model: Model, most: int) -> None:
        self._model, self._most = model, most
        self._kept: OrderedDict[str, Any] = OrderedDict()

    def of(self, view: View) -> Any:
        """The features of an image, computed where they are not kept."""
        if view.key not in self._kept:
            self._kept[view.key] = self._model.features(view)
        self._kept.move_to_end(view.key)
        found = self._kept[view.key]
        while len(self._kept) > self._most:
            self._kept.popitem(last=False)
        return found


class Tracker:
    """Answers the messages of the protocol with one model."""

    def __init__(self, model: Model, batch: int, cache: int) -> None:
        self._model, self._batch = model, batch
        self._features = FeatureCache(model, cache)
        self._keyframe: Keyframe | None = None

    def answer(self, message: Mapping[str, Any]) -> dict[str, Any]:
        """The answer to any message but ``stop``, without its id."""
        if message["type"] == "start":
            return {"type": "ready", "batch": self._batch}
        if message["type"] == "reference":
            self._keyframe = read_keyframe(message)
            return {"type": "ready"}
        if message["type"] == "queries":
            return {"type": "results", "results": self._results([read_view(each) for each in message["queries"]])}
        return {"type": "result", **self._results([read_view(message)])[0]}

    def _results(self, views: Sequence[View]) -> list[dict[str, Any]]:
        """The results of some queries. What a batch raises is found out query by query."""
        assert self._keyframe is not None, "a reference comes before its queries"
        try:
            features = [self._features.of(view) for view in (self._keyframe, *views)]
            answers = self._model.track(self._keyframe, features[0], views, features[1:])
            return [_result(each) for each in answers]
        except Exception as bad:  # noqa: BLE001  a model may raise anything; without weights loaded again it goes on
            if len(views) > 1:
                return [self._results([view])[0] for view in views]
            traceback.print_exc()
            told = f"{type(bad).__name__}: {bad}"
            return [_result(Answer(None, message=told, info={"status": "error"}))]


def _result(answer: Answer) -> dict[str, Any]:
    """An answer as JSON has it, in which there are no NaN."""
    pose, message, confidence = answer.T_query_ref, answer.message, answer.confidence
    if pose is not None and not np.isfinite(pose).all():
        pose, message = None, "the model's pose is not finite"
    if confidence is not None and not np.isfinite(confidence):
        confidence = None
    return {
        "pose": None if pose is None else np.concatenate(transform_to_tq(pose)).tolist(),
        "confidence": None if confidence is None else float(confidence),
        "message": message,
        "info": dict(answer.info),
    }


def best_device() -> str:
    """``cuda`` or ``mps`` where PyTorch is installed and finds one, else ``cpu``."""
    if importlib.util.find_spec("torch") is None:
        return "cpu"
    import torch

    if torch.cuda.is_available():
        return "cuda"
    return "mps" if torch.backends.mps.is_available() else "cpu"


def protocol_stream() -> TextIO:
    """Standard output for the protocol alone: whatever else is printed goes to standard error from now on."""
    stream = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    return stream


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--device", default="auto", help="where the model runs; auto: a GPU if there is one")
    parser.add_argument("--batch", type=int, default=Model.batch, help="queries that are answered at once")
    parser.add_argument("--cache", type=int, default=64, help="images whose features are kept")
    chosen = parser.parse_args()
    stream = protocol_stream()
    tracker: Tracker | None = None
    for line in sys.stdin:
        message = json.loads(line)
        if message["type"] == "stop":
            break
        if tracker is None:
            began = time.perf_counter()
            model = Model(best_device() if chosen.device == "auto" else chosen.device)
            print(f"loaded on {model.device} in {time.perf_counter() - began:.1f} s", file=sys.stderr)
            tracker = Tracker(model, chosen.batch, chosen.cache)
        print(json.dumps({**tracker.answer(message), "id": message["id"]}), file=stream, flush=True)


if __name__ == "__main__":
    main()
