"""Checking that a retriever keeps the contract, on a few easy and degenerate images."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Image
from relocbench.evaluation.common.contract import Finding, attempt, constructed, constructed_again
from relocbench.evaluation.isolation.guard import guarded, implements
from relocbench.evaluation.retrieval.opening import SetOptions, open_set
from relocbench.evaluation.retrieval.output_checks import checked_descriptors, checked_scores, rerank_top_of
from relocbench.execution import messages_to_stderr
from relocbench.methods import MethodSpec
from relocbench.progress import Silent
from relocbench.retrieval import FittingRetriever, ImageView, RerankingRetriever, Retriever

_CLOSE = 1e-3
"""tolerance for descriptors of norm 1: batches of another size add up floats in another order"""
_EQUAL = 1e-6
_FROM_DATASET = 3


def check_retriever(spec: MethodSpec, dataset: Path | None = None) -> list[Finding]:
    """Try a retriever on synthetic images of several sizes and views and, with a dataset, on some of its images.

    Raises:
        RelocbenchError: the retriever cannot be constructed, or the dataset is bad.
    """
    made, finding = constructed(spec)
    findings = [finding]
    if not finding.passed:
        return findings
    if not implements(made, Retriever):
        return [*findings, Finding("has describe()", False, f"{type(made).__name__} has none")]
    images = [*_made_up(), *(_from_dataset(dataset) if dataset else [])]
    if implements(made, FittingRetriever):
        findings.append(_fits(made, images))
        if not findings[-1].passed:
            return findings
    values, problem = _describe(made, images)
    findings.append(Finding(f"describes {len(images)} images together", problem is None, problem or _words(values)))
    for image in images:
        one, fault = _describe(made, [image])
        findings.append(Finding(f"describes {image.key}", fault is None, fault or _words(one)))
    if problem is None:
        findings.append(_single_equals_batch(made, images, values))
        findings.append(_repeatable(spec, images, values))
        findings.append(_distinguishes_images(values))
    findings.append(_leaves_input_alone(made, images[0]))
    if problem is None and guarded(lambda: callable(getattr(made, "rerank", None)))[0] is True:
        findings.append(_reranks(made, values))
    return findings


def _describe(made: Any, images: Sequence[ImageView]) -> tuple[Any, str | None]:
    fresh = [ImageView(image.key, image.view, image.read) for image in images]
    values, problem = attempt(
        lambda: made.describe(fresh), "for an image that cannot be described, return a row of NaN"
    )
    return checked_descriptors(values, problem, len(images))


def _fits(made: FittingRetriever, images: Sequence[ImageView]) -> Finding:
    with messages_to_stderr():
        _, problem = guarded(lambda: made.fit(images, 0), placed=True)
    return Finding("fits to a gallery", problem is None, problem or "")


def _single_equals_batch(made: Any, images: Sequence[ImageView], values: NDArray[Any]) -> Finding:
    """Describe each image by itself, in the opposite order."""
    name = "describes an image in the same way in any batch"
    for index in reversed(range(len(images))):
        alone, problem = _describe(made, [images[index]])
        if problem or not _same(alone[0], values[index], _CLOSE):
            return Finding(name, False, f"{images[index].key}: {problem or 'another descriptor than together'}")
    return Finding(name, True)


def _repeatable(spec: MethodSpec, images: Sequence[ImageView], values: NDArray[Any]) -> Finding:
    name = "describes the same again, constructed anew"
    fresh, problem = constructed_again(spec)
    if problem is None and implements(fresh, FittingRetriever):
        problem = _fits(fresh, images).detail or None
    if problem is not None:
        return Finding(name, False, problem)
    again, problem = _describe(fresh, images)
    same = problem is None and all(_same(a, b, _EQUAL) for a, b in zip(again, values, strict=True))
    return Finding(name, same, "" if same else problem or "another descriptor than the first time")


def _distinguishes_images(values: NDArray[Any]) -> Finding:
    """Check that street, drone and satellite of the synthetic images, which differ, are described differently."""
    known = values[:3][np.isfinite(values[:3]).all(axis=1)]
    apart = len(known) < 2 or float(np.ptp(known, axis=0).max()) > 0
    return Finding("describes different images differently", apart, "" if apart else "all descriptors are the same")


def _leaves_input_alone(made: Any, image: ImageView) -> Finding:
    view = ImageView(image.key, image.view, image.read)
    before = view.image.copy()
    with messages_to_stderr():
        guarded(lambda: made.describe([view]))
    return Finding("leaves the images it is given unchanged", bool(np.array_equal(before, view.image)))


def _reranks(made: RerankingRetriever, values: NDArray[Any]) -> Finding:
    top, fault = rerank_top_of(made)
    name = f"re-ranks the first {top}"
    if fault is not None:
        return Finding(name, False, fault)
    if top == 0:
        return Finding(name, True, "not requested")
    known = values[np.isfinite(values).all(axis=1)]
    if not len(known):
        return Finding(name, False, "no image has a descriptor")
    for count in dict.fromkeys((min(len(known), top), 1)):
        with messages_to_stderr():
            scores, crash = guarded(lambda k=count: made.rerank(known[0], known[:k]), placed=True)  # type: ignore[misc]
        _, problem = checked_scores(scores, crash, count)
        if problem:
            return Finding(name, False, problem)
    return Finding(name, True)


def _same(a: NDArray[Any], b: NDArray[Any], tolerance: float) -> bool:
    if not np.isfinite(a).all() or not np.isfinite(b).all():
        return bool(np.isfinite(a).all() == np.isfinite(b).all())
    return bool(np.abs(a - b).max() <= tolerance * max(float(np.linalg.norm(b)), 1e-12))


def _words(values: NDArray[Any]) -> str:
    blind = int(np.sum(~np.isfinite(values).all(axis=1)))
    return f"{values.shape[1]} numbers each" + (f", {blind} not described" if blind else "")


def _made_up() -> list[ImageView]:
    """Synthetic images: texture in three views and sizes, two without any texture, noise, and a tiny one."""
    rng = np.random.default_rng(0)
    plain: Image = np.full((96, 128, 3), 127, dtype=np.uint8)
    noise: Image = rng.integers(0, 256, (128, 128, 3), dtype=np.uint8)
    images: dict[tuple[str, str], Image] = {
        ("a street", "street"): _texture(rng, 96, 160),
        ("a drone image", "drone"): _texture(rng, 128, 128),
        ("a satellite image", "satellite"): _texture(rng, 200, 200),
        ("a black image", "street"): np.zeros_like(plain),
        ("a plain grey image", "street"): plain,
        ("noise", "drone"): noise,
        ("an image of 16 x 16 pixels", "satellite"): _texture(rng, 16, 16),
    }
    return [ImageView(key, view, lambda image=image: image.copy()) for (key, view), image in images.items()]  # type: ignore[misc]


def _texture(rng: np.random.Generator, height: int, width: int) -> Image:
    """Random coloured blocks of several sizes."""
    total = np.zeros((height, width, 3))
    for size in (4, 12, 32):
        coarse = rng.random((height // size + 1, width // size + 1, 3))
        total += np.repeat(np.repeat(coarse, size, axis=0), size, axis=1)[:height, :width]
    return np.rint(total * 85).astype(np.uint8)


def _from_dataset(path: Path) -> list[ImageView]:
    task = open_set(path, path.parent / "nowhere", SetOptions(), Silent()).chosen[0]
    return [*task.gallery[:_FROM_DATASET], *task.queries[:_FROM_DATASET]]
