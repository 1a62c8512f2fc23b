"""Every second pair is asked, and the images of the others tell nothing about what belongs together."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import university_sample
from made_places import picture

from relocbench.datasets.core.images import as_rgb, read_image
from relocbench.methods import RETRIEVERS, parse_method
from relocbench.metrics import relevance_from_lists
from relocbench.retrieval import ImageView, RetrievalTask

COUNT = 20


def task(query: str, gallery: str) -> RetrievalTask:
    images = {
        view: tuple(ImageView(f"{view}{n}", view, partial(picture, n, view, 0, 16)) for n in range(COUNT))
        for view in (query, gallery)
    }
    relevance = relevance_from_lists([[n] for n in range(COUNT)], COUNT)
    groups = tuple(map(str, range(COUNT)))
    return RetrievalTask(f"{query}-{gallery}", images[query], images[gallery], relevance, groups=groups)


def test_odd_pairs_are_asked_in_the_whole_gallery() -> None:
    odd = university_sample.odd_pairs(task("drone", "satellite"))
    assert [image.key for image in odd.queries] == [f"drone{n}" for n in range(1, COUNT, 2)]
    assert odd.groups == tuple(str(n) for n in range(1, COUNT, 2))
    assert len(odd.gallery) == odd.relevance.gallery == COUNT
    assert [odd.relevance.of(k).tolist() for k in range(COUNT // 2)] == [[n] for n in range(1, COUNT, 2)]


def test_the_images_of_even_pairs_do_not_tell_which_belong_together(tmp_path: Path) -> None:
    university_sample.write_even_pairs([task("drone", "satellite"), task("satellite", "drone")], tmp_path)
    places = {}
    for view in ("drone", "satellite"):
        pictures = {picture(n, view, 0, 16).tobytes(): n for n in range(COUNT)}
        files = sorted((tmp_path / view).iterdir())
        shown = [as_rgb(read_image(path)) for path in files]
        places[view] = [pictures[np.ascontiguousarray(image).tobytes()] for image in shown]
        assert sorted(places[view]) == list(range(0, COUNT, 2))
        assert places[view] != list(range(0, COUNT, 2))
    assert places["drone"] != places["satellite"]


def test_an_image_is_described_once_and_a_gallery_is_fitted_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    described: list[str] = []

    class Plain:
        def describe(self, images: list[ImageView]) -> np.ndarray:
            described.extend(image.key for image in images)
            return np.stack([image.image.ravel().astype(float) for image in images])

    class Fitting(Plain):
        fitted = False

        def fit(self, gallery: object, seed: int) -> None:
            assert not self.fitted
            self.fitted = True

    both = [task("drone", "satellite"), task("satellite", "drone")]
    spec = parse_method("colour-histogram", kind=RETRIEVERS)
    monkeypatch.setattr(type(spec), "create", lambda self: Fitting())
    fitting = university_sample.Asked(spec, 0)
    first = fitting.metrics(both[0])
    assert len(described) == 2 * COUNT
    assert fitting.metrics(both[0]) == first
    assert len(described) == 4 * COUNT
    monkeypatch.setattr(type(spec), "create", lambda self: Plain())
    plain = university_sample.Asked(spec, 0)
    described.clear()
    assert plain.metrics(both[0]) == first
    plain.metrics(both[1])
    assert len(described) == len(set(described)) == 2 * COUNT


def test_a_label_without_a_method_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["x", str(tmp_path), "--method", "a=colour-histogram", "--unlabelled", "b"])
    with pytest.raises(SystemExit) as left:
        university_sample.main()
    assert left.value.code == 2
    assert "--unlabelled b: no --method has that label" in capsys.readouterr().err
