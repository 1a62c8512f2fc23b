"""What ``realism.py`` measures on groups of pictures: a classifier's error, Fréchet distances, plain statistics."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise

import cv2
import numpy as np
import torch
from scipy.optimize import minimize

from baselines.efficientnet_lite import DEVIATION, MEAN, EfficientNetLite0, load_imagenet
from relocbench.arrays import Array, Image, Mask

Rows = Mapping[str, Array]
"""group -> one row (N, D) for each picture"""

PENALTY = 0.1
"""weight of half the squared norm of the classifier's weights"""
DIMENSIONS = 16
"""of the Fréchet distance: halves of the photographs have some 70 pictures, which determine no more covariances"""
_RESAMPLED = 400
_INTERVAL = (2.5, 97.5)
_BATCH = 16
_STAGES = {"stage 1 (1/2)": 0, "stage 3 (1/8)": 2, "stage 5 (1/16)": 4, "stage 7 (1/32)": 6}
WHOLE = "stage 7 (1/32)"
_STRIPS = {"upper third": slice(0, 11), "middle third": slice(11, 21), "lower third": slice(21, 32)}
"""rows of the map of 1/8 of the size, that of stage 3"""


@torch.inference_mode()
def described(pictures: Sequence[Image]) -> dict[str, Array]:
    """Mean activations of EfficientNet-Lite0 with ImageNet's weights, (N, D) by stage or part of the picture.

    Raises:
        MethodError: the package that holds the weights is not installed.
    """
    network = EfficientNetLite0().eval()
    load_imagenet(network)
    mean, deviation = (torch.tensor(values)[:, None, None] for values in (MEAN, DEVIATION))
    found: dict[str, list[Array]] = {}
    for start in range(0, len(pictures), _BATCH):
        batch = torch.from_numpy(np.stack(pictures[start : start + _BATCH])).permute(0, 3, 1, 2).float() / 255
        maps = network((batch - mean) / deviation)
        parts = {name: maps[number] for name, number in _STAGES.items()}
        parts |= {name: maps[2][:, :, rows] for name, rows in _STRIPS.items()}
        for name, part in parts.items():
            found.setdefault(name, []).append(part.mean((2, 3)).double().numpy())
    return {name: np.concatenate(rows) for name, rows in found.items()}


Measure = Callable[[Sequence[str], Sequence[str]], float]
"""a number of some photographic sets and some towns, which may be named repeatedly"""


def resampled(measure: Measure, sets: Sequence[str], towns: Sequence[str]) -> list[float]:
    """95 % interval of a measure over sets and towns that are drawn with replacement."""
    rng = np.random.default_rng(0)

    def drawn(groups: Sequence[str]) -> list[str]:
        return [groups[k] for k in rng.integers(len(groups), size=len(groups))]

    values = [measure(drawn(sets), drawn(towns)) for _ in range(_RESAMPLED)]
    return [float(v) for v in np.percentile(values, _INTERVAL)]


@dataclass(frozen=True)
class Told:
    """How a linear classifier answers for each set and town after training on all others."""

    wrong: dict[str, float]
    """share of the pictures of a set or town that are taken for the other kind; a tie is half an error"""
    surprise: dict[str, float]
    """mean surprise by the truth in bits: 0 always sure and right, 1 nobody can tell"""

    def error(self, sets: Sequence[str], towns: Sequence[str]) -> float:
        """Mean of the errors for photographs and for frames; 0.5: nobody can tell."""
        return (_mean(self.wrong, sets) + _mean(self.wrong, towns)) / 2

    def photographs(self, sets: Sequence[str], towns: Sequence[str]) -> float:
        """Share of photographs that are taken for rendered."""
        return _mean(self.wrong, sets)

    def frames(self, sets: Sequence[str], towns: Sequence[str]) -> float:
        """Share of rendered frames that are taken for photographs."""
        return _mean(self.wrong, towns)

    def bits(self, sets: Sequence[str], towns: Sequence[str]) -> float:
        """Mean surprise, of which photographs and frames are half each."""
        return (_mean(self.surprise, sets) + _mean(self.surprise, towns)) / 2


def _mean(of: Mapping[str, float], groups: Sequence[str]) -> float:
    return float(np.mean([of[group] for group in groups]))


def told_apart(real: Rows, rendered: Rows) -> Told:
    """The answers of linear classifiers, each for the one group that it was not trained on."""
    wrong, surprise = {}, {}
    for own, sign in ((real, 1), (rendered, -1)):
        for name in own:
            kept = [np.concatenate([rows for g, rows in groups.items() if g != name]) for groups in (real, rendered)]
            log_odds = sign * linear_classifier(*kept)(own[name])
            wrong[name] = float(np.mean((log_odds < 0) + 0.5 * (log_odds == 0)))
            surprise[name] = float(np.mean(np.logaddexp(0, -log_odds)) / np.log(2))
    return Told(wrong, surprise)


def linear_classifier(real: Array, rendered: Array) -> Callable[[Array], Array]:
    """Logistic regression with a squared penalty, both classes of the same weight.

    Args:
        real, rendered: one row (N, D) for each picture; columns are standardised by both together.

    Returns:
        Function of rows (M, D): log odds (M,) that a picture is real.
    """
    x = np.concatenate([real, rendered])
    centre, spread = x.mean(axis=0), x.std(axis=0) + 1e-9
    x = np.column_stack([(x - centre) / spread, np.ones(len(x))])
    sign = np.repeat([1.0, -1.0], [len(real), len(rendered)])
    weight = np.repeat([0.5 / len(real), 0.5 / len(rendered)], [len(real), len(rendered)])
    penalty = np.append(np.full(x.shape[1] - 1, PENALTY), 0.0)

    def loss(w: Array) -> tuple[float, Array]:
        margin = sign * (x @ w)
        slope = -weight * sign / (1 + np.exp(np.clip(margin, -500, 500)))
        return float(weight @ np.logaddexp(0, -margin) + penalty @ w**2 / 2), x.T @ slope + penalty * w

    w = minimize(loss, np.zeros(x.shape[1]), jac=True, method="L-BFGS-B", options={"maxiter": 500}).x
    return lambda rows: np.asarray((rows - centre) / spread @ w[:-1] + w[-1])


def frechet(a: Array, b: Array) -> float:
    """The squared Fréchet distance of Gaussians with the means and covariances of rows (N, D) and (M, D).

    ``|m_a - m_b|^2 + tr(C_a + C_b - 2 (C_a^(1/2) C_b C_a^(1/2))^(1/2))``: Dowson and Landau, Journal of Multivariate
    Analysis 12, 1982; on features of a network it is the FID of Heusel et al., NeurIPS 2017.
    """
    covariance_a, covariance_b = (np.atleast_2d(np.cov(rows, rowvar=False)) for rows in (a, b))
    values, vectors = np.linalg.eigh(covariance_a)
    root = (vectors * np.sqrt(np.maximum(values, 0))) @ vectors.T
    crossed = np.linalg.eigvalsh(root @ covariance_b @ root)
    shift = float(np.sum((a.mean(axis=0) - b.mean(axis=0)) ** 2))
    spread = float(np.trace(covariance_a) + np.trace(covariance_b) - 2 * np.sqrt(np.maximum(crossed, 0)).sum())
    return shift + spread


def principal(rows: Array, dimensions: int) -> tuple[Callable[[Array], Array], float]:
    """Projection onto the first principal components of rows (N, D), and the share of variance that they hold."""
    centre = rows.mean(axis=0)
    _, lengths, axes = np.linalg.svd(rows - centre, full_matrices=False)
    share = float(np.sum(lengths[:dimensions] ** 2) / np.sum(lengths**2))
    return lambda each: np.asarray((each - centre) @ axes[:dimensions].T), share


class Distances:
    """Fréchet distances in the first principal components of the photographs' features."""

    def __init__(self, real: Rows, rendered: Rows) -> None:
        projected, self.variance_kept = principal(np.concatenate([*real.values()]), DIMENSIONS)
        self._real, self._rendered = ({g: projected(rows) for g, rows in each.items()} for each in (real, rendered))

    def all(self, sets: Sequence[str], towns: Sequence[str]) -> float:
        """The distance of all pictures of these photographic sets and towns."""
        return frechet(
            np.concatenate([self._real[s] for s in sets]), np.concatenate([self._rendered[t] for t in towns])
        )

    def halves(self) -> dict[str, list[float]]:
        """Median, smallest and largest distance between halves of the groups.

        Halves are compared with halves, since the distance of few pictures is larger than that of many: photographs
        with photographs and towns with towns in all ways to part them, and one half of each in all ways to choose them.
        """
        own = [[frechet(a, b) for a, b in _halves(groups)] for groups in (self._real, self._rendered)]
        both = [frechet(a, b) for one in _halves(self._real) for a in one for b, _ in _halves(self._rendered)]
        names = ("real and rendered halves", "real halves", "rendered halves")
        return {name: [float(np.median(v)), min(v), max(v)] for name, v in zip(names, (both, *own), strict=True)}


def _halves(groups: Rows) -> Iterator[tuple[Array, Array]]:
    """All ways to part groups into two halves, each of which has a third of the pictures or more."""
    names = sorted(groups)
    total = sum(len(rows) for rows in groups.values())
    for some in combinations(names, len(names) // 2):
        first = np.concatenate([groups[name] for name in some])
        second = np.concatenate([groups[name] for name in names if name not in some])
        if min(len(first), len(second)) >= total / 3:
            yield first, second


_BANDS = ("1 to 2 px", "2 to 4 px", "4 to 8 px", "8 to 16 px", "16 to 32 px")
_PATCH = 8


def statistics(picture: Image) -> dict[str, float]:
    """Plain statistics of a picture (SIZE, SIZE, 3). Contrasts are decadic logarithms; shares are of pixels.

    The road is the lower third of the middle half, the top is the upper quarter.
    """
    rgb = picture.astype(np.float64) / 255
    grey = rgb @ [0.299, 0.587, 0.114]
    chroma = rgb.max(axis=2) - rgb.min(axis=2)
    rows, columns = picture.shape[:2]
    road = np.s_[2 * rows // 3 :, columns // 4 : 3 * columns // 4]
    top = np.s_[: rows // 4]
    bands = dict(zip(_BANDS, _bands(grey), strict=True))
    dx, dy = np.diff(grey, axis=1)[:-1], np.diff(grey, axis=0)[:, :-1]
    steep = np.hypot(dx, dy)
    fine, spread, level, colour = (_patches(each) for each in (bands[_BANDS[0]], grey, grey, chroma))
    flat: Mask = spread.std(axis=1) < 1.5 / 255
    kinds = np.stack([level.mean(axis=1) * 8, colour.mean(axis=1) * 8, 2 * np.log10(fine.std(axis=1) + 1e-3) + 6])
    found = {f"contrast at {name}": _contrast(band) for name, band in bands.items()}
    found |= {f"road: contrast at {name}": _contrast(bands[name][road]) for name in (*_BANDS[:2], *_BANDS[3:])}
    return found | {
        "slope of contrast (fine over coarse)": found["contrast at 1 to 2 px"] - found["contrast at 16 to 32 px"],
        "contrast at 1 to 2 px, flattest tenth": float(np.log10(np.quantile(fine.std(axis=1), 0.1) + 1e-4)),
        "share of flat patches": float(flat.mean()),
        "steepest edges over mean": float(np.log10((np.quantile(steep, 0.995) + 1e-4) / (steep.mean() + 1e-4))),
        "upright and level edges": _axis_share(dx, dy),
        "kinds of patches (bits)": _entropy(kinds.round().astype(int).T),
        "colours (bits)": _entropy(picture.reshape(-1, 3) // 32),
        "brightness": float(grey.mean()),
        "spread of brightness": float(grey.std()),
        "share of black": float((grey < 0.06).mean()),
        "share of white": float((grey > 0.97).mean()),
        "chroma": float(chroma.mean()),
        "chroma, most colourful 2 %": float(np.quantile(chroma, 0.98)),
        "road: chroma": float(chroma[road].mean()),
        "road: blue over red": float((rgb[..., 2] - rgb[..., 0])[road].mean()),
        "road: brightness": float(grey[road].mean()),
        "top: share of white": float((grey[top] > 0.97).mean()),
        "top: contrast at 16 to 32 px": _contrast(bands[_BANDS[4]][top]),
    }


def _bands(grey: Array) -> list[Array]:
    """Differences of Gaussians whose widths double."""
    blurred = [grey, *(cv2.GaussianBlur(grey, (0, 0), 0.7 * 2**k) for k in range(len(_BANDS)))]
    return [a - b for a, b in pairwise(blurred)]


def _contrast(band: Array) -> float:
    return float(np.log10(np.sqrt(np.mean(band**2)) + 1e-4))


def _patches(values: Array) -> Array:
    """(N, P * P) of values (H, W)."""
    rows, columns = (side // _PATCH for side in values.shape)
    whole = values[: rows * _PATCH, : columns * _PATCH].reshape(rows, _PATCH, columns, _PATCH)
    return whole.transpose(0, 2, 1, 3).reshape(-1, _PATCH * _PATCH)


def _axis_share(dx: Array, dy: Array) -> float:
    """Share of the gradients' energy within 10 degrees of a picture's axes."""
    energy = dx**2 + dy**2
    along = np.minimum(np.abs(dx), np.abs(dy)) <= np.tan(np.radians(10)) * np.maximum(np.abs(dx), np.abs(dy))
    return float(energy[along].sum() / (energy.sum() + 1e-12))


def _entropy(rows: Array | Image) -> float:
    """Entropy of rows (N, D) in bits."""
    share = np.unique(rows, axis=0, return_counts=True)[1] / len(rows)
    return float(-(share * np.log2(share)).sum())


@dataclass(frozen=True)
class Effect:
    """How far rendered pictures are from photographs in one statistic."""

    size: float
    """Glass's delta: the difference of means in standard deviations of the photographs; groups weigh the same"""
    interval: list[float]
    """95 %, over sets and towns drawn with replacement"""
    real: float
    rendered: float


def effect(real: Rows, rendered: Rows) -> Effect:
    """The effect size of one statistic, whose values (N, 1) are given for each group.

    Source: Glass, Primary, secondary, and meta-analysis of research, Educational Researcher 5, 1976.
    """
    means = {name: float(rows.mean()) for groups in (real, rendered) for name, rows in groups.items()}
    grand = _mean(means, [*real])
    spread = float(np.sqrt(np.mean([np.mean((rows - grand) ** 2) for rows in real.values()]))) + 1e-9

    def size(sets: Sequence[str], towns: Sequence[str]) -> float:
        return (_mean(means, towns) - _mean(means, sets)) / spread

    interval = resampled(size, [*real], [*rendered])
    return Effect(size([*real], [*rendered]), interval, grand, _mean(means, [*rendered]))
