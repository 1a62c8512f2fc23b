"""Networks with weights that nobody trained, from ALIKED to LightGlue and LoFTR: files, shapes, pixels, errors."""

from __future__ import annotations

import sys
import tomllib
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, get_args

import cv2
import numpy as np
import pytest
import torch
from refusals import refused
from repository import ROOT
from safetensors.torch import save_file
from small_dataset import make_small_dataset
from torch import Tensor, nn

import baselines.learned_pnp as learned_pnp
from baselines.feature_pnp.features import Features
from baselines.learned_pnp.detector import NetworkDetector
from baselines.learned_pnp.kornia_networks import Aliked, Disk, XFeat
from baselines.learned_pnp.lightglue import LightGlue
from baselines.learned_pnp.loftr import Loftr, LoftrModel
from baselines.learned_pnp.superpoint import SuperPoint, SuperPointNetwork
from relocbench.arrays import Image
from relocbench.datasets.core.dataset import Dataset
from relocbench.errors import MethodError
from relocbench.tracking import Query, Reference
from relocbench.weights import SupportsFetching

kornia = pytest.importorskip("kornia.feature", reason="the extra 'learned' is not installed")

DETECTORS: dict[str, type[NetworkDetector]] = {
    "aliked": Aliked,
    "disk": Disk,
    "xfeat": XFeat,
    "superpoint": SuperPoint,
}
TRACKERS = {
    made.name: made for made in (getattr(learned_pnp, name) for name in learned_pnp.__all__) if hasattr(made, "name")
}


def drawn_state(network: nn.Module, weight: float = 0.08, bias: float = 0.1) -> dict[str, Tensor]:
    """Normal numbers for a network, from NumPy, whose streams do not change with the version of torch."""
    rng = np.random.default_rng(0)
    return {
        name: torch.tensor(rng.normal(0, weight if value.ndim > 1 else bias, tuple(value.shape)), dtype=torch.float32)
        for name, value in network.state_dict().items()
    }


def disk_file() -> dict[str, Any]:
    return {"extractor": kornia.DISK().state_dict()}


def xfeat_file() -> dict[str, Any]:
    state = kornia.XFeat().net.state_dict()
    state["keypoint_head.3.weight"] *= 30.0  # undecided between the 65 classes, nothing would be a keypoint
    return dict(state)


def superpoint_file() -> dict[str, Any]:
    return drawn_state(SuperPointNetwork())


def lightglue_file(dimension: int) -> dict[str, Any]:
    """With the names that the authors' files have."""
    state = kornia.LightGlue(features=None, input_dim=dimension).state_dict()
    del state["confidence_thresholds"]
    moved = {}
    for name, value in state.items():
        words = name.split(".")
        named = [words[2], words[1], *words[3:]] if words[0] == "transformers" else words
        moved[".".join(named)] = value
    return moved


def loftr_file() -> dict[str, Any]:
    state = kornia.LoFTR(pretrained=None).state_dict()
    return {"state_dict": {f"matcher.{name}": value for name, value in state.items()}}


FILES: dict[str, Callable[[], dict[str, Any]]] = {
    "disk": disk_file,
    "xfeat": xfeat_file,
    "superpoint": superpoint_file,
    "lightglue128": lambda: lightglue_file(128),
    "lightglue256": lambda: lightglue_file(256),
    "loftr": loftr_file,
    "aliked": lambda: {
        name: value for name, value in kornia.ALIKED("aliked-n16").state_dict().items() if name != "dkd.hw_grid"
    },
}


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """A file of weights by the name of its network, made when it is first asked for."""
    folder = tmp_path_factory.mktemp("weights")

    def file(name: str) -> Path:
        path = folder / f"{name}.pth"
        if not path.exists():
            torch.manual_seed(0)
            torch.save(FILES[name](), path)
        return path

    return file


@pytest.fixture(scope="module")
def views(tmp_path_factory: pytest.TempPathFactory) -> tuple[Reference, Query]:
    """A keyframe and a query of the same rendered corner, 128 x 96."""
    dataset: Dataset = make_small_dataset(tmp_path_factory.mktemp("data") / "small", frames=2, size=(128, 96))
    pair_set = dataset.pair_set(dataset.pair_set_names[0])
    pair = pair_set.pairs[0]
    return dataset.reference(pair_set, pair), dataset.query(pair_set, pair)


def pattern(height: int, width: int, seed: int = 0) -> Image:
    """Blocks of random colours, blurred."""
    blocks = np.random.default_rng(seed).integers(0, 256, (height // 8 + 1, width // 8 + 1, 3), dtype=np.uint8)
    whole = np.repeat(np.repeat(blocks, 8, axis=0), 8, axis=1)[:height, :width]
    return np.asarray(cv2.GaussianBlur(whole, (0, 0), 1.0), dtype=np.uint8)


@pytest.mark.parametrize("name", list(DETECTORS))
def test_features_are_sorted_and_of_norm_1(drawn: Callable[[str], Path], name: str) -> None:
    detector = DETECTORS[name](drawn(name), 40, 1280, "cpu")
    image = pattern(96, 128)
    image.flags.writeable = False
    with warnings.catch_warnings(action="error"):
        found = detector(image)  # evaluation hands over images that nobody can write to
    assert 5 < len(found) <= 40
    assert found.size == (128, 96)
    assert np.all(np.diff(found.response) <= 0), "the strongest first"
    assert found.descriptors.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(found.descriptors, axis=1), 1.0, atol=1e-5)
    assert np.all((found.uv >= 0) & (found.uv <= np.array([127, 95])))
    grey = image[..., 1]
    for same in (grey[..., None], np.dstack([grey] * 3)):
        np.testing.assert_array_equal(detector(grey).uv, detector(same).uv)


@pytest.mark.parametrize("name", list(DETECTORS))
def test_keypoints_of_a_shrunk_image_are_pixels_of_the_original(drawn: Callable[[str], Path], name: str) -> None:
    small = pattern(96, 128)
    large = np.asarray(cv2.resize(small, None, fx=2, fy=2, interpolation=cv2.INTER_NEAREST), dtype=np.uint8)
    direct = DETECTORS[name](drawn(name), 100, 1280, "cpu")(small)
    shrunk = DETECTORS[name](drawn(name), 100, 128, "cpu")(large)  # the same image again, by areas of 2 x 2
    np.testing.assert_allclose(shrunk.uv, (direct.uv + 0.5) * 2.0 - 0.5, atol=1e-9)
    assert set(shrunk.scale) == {2.0}
    assert shrunk.size == (256, 192)
    np.testing.assert_array_equal(shrunk.descriptors, direct.descriptors)


@pytest.mark.parametrize("name", list(DETECTORS))
def test_sides_need_not_be_multiples(drawn: Callable[[str], Path], name: str) -> None:
    found = DETECTORS[name](drawn(name), 60, 1280, "cpu")(pattern(101, 143))
    factor = np.array([143 / 128, 101 / 96]) if name == "xfeat" else np.ones(2)
    whole = (found.uv + 0.5) / factor - 0.5
    assert len(found) > 5
    if name != "aliked":  # whose keypoints lie between pixels
        np.testing.assert_allclose(whole, np.rint(whole), atol=1e-6)
    with refused(MethodError, "", None, 64):
        DETECTORS[name](drawn(name), 60, 1280, "cpu")(pattern(63, 128))


def test_superpoint_is_the_network_of_the_paper(tmp_path: Path) -> None:
    # Expected: SuperPointForKeypointDetection of transformers 5.23.0 with these weights, without keypoints within 4
    # pixels of the right and lower side, which it keeps.
    torch.save(drawn_state(SuperPointNetwork()), tmp_path / "drawn.pth")
    grey = cv2.cvtColor(pattern(96, 128), cv2.COLOR_RGB2GRAY)
    found = SuperPoint(tmp_path / "drawn.pth", 1000, 1280, "cpu")(np.asarray(grey, dtype=np.uint8))
    assert len(found) == 170
    assert found.uv[:5].tolist() == [[59, 8], [19, 8], [35, 8], [75, 8], [51, 8]]
    np.testing.assert_allclose(found.response[:3], [0.99827862, 0.99753773, 0.99725229], rtol=1e-5)
    first = [[-0.02568439, 0.03489812, 0.12267462], [-0.02925127, 0.03442897, 0.10958537]]
    np.testing.assert_allclose(found.descriptors[:2, :3], first, atol=1e-5)


@pytest.mark.parametrize(
    ("name", "make"),
    [
        ("aliked", lambda path: Aliked(path, 10, 1280, "cpu")),
        ("disk", lambda path: Disk(path, 10, 1280, "cpu")),
        ("xfeat", lambda path: XFeat(path, 10, 1280, "cpu")),
        ("superpoint", lambda path: SuperPoint(path, 10, 1280, "cpu")),
        pytest.param("lightglue128", lambda path: LightGlue(path, 128, 0.1, "cpu"), marks=pytest.mark.thorough),
        pytest.param("loftr", lambda path: Loftr(path, "outdoor", 0.2, 840, "cpu"), marks=pytest.mark.thorough),
    ],
)
def test_files_of_another_network_are_refused_by_name(
    drawn: Callable[[str], Path], tmp_path: Path, name: str, make: Callable[[Path], object]
) -> None:
    whole = torch.load(drawn(name), weights_only=True)
    tensors: dict[str, Tensor] = next((dict(v) for v in whole.values() if isinstance(v, Mapping)), whole)
    make(drawn(name))
    save_file({each: tensor.contiguous() for each, tensor in tensors.items()}, tmp_path / "flat.safetensors")
    make(tmp_path / "flat.safetensors")
    gone = next(each for each in tensors if each.endswith("weight"))
    torch.save({each: tensor for each, tensor in tensors.items() if each != gone}, tmp_path / "less.pth")
    with refused(MethodError, tmp_path / "less.pth", None, gone.removeprefix("matcher.")):
        make(tmp_path / "less.pth")
    torch.save({**tensors, "more": torch.zeros(1)}, tmp_path / "more.pth")
    with refused(MethodError, tmp_path / "more.pth", None, "more"):
        make(tmp_path / "more.pth")
    (tmp_path / "text.pth").write_text("hello")
    with refused(MethodError, tmp_path / "text.pth"):
        make(tmp_path / "text.pth")


@pytest.mark.parametrize(
    ("tensor", "change", "names"),
    [
        ("conv1.weight", lambda _: torch.zeros(2, 2, 1, 1), ("(2, 2, 1, 1)",)),
        ("conv1.weight", lambda right: right.fill_(torch.nan), ()),
        ("block1.bn1.running_mean", lambda _: None, ()),
    ],
)
def test_a_tensor_of_another_shape_not_finite_or_missing_is_refused_by_name(
    drawn: Callable[[str], Path],
    tmp_path: Path,
    tensor: str,
    change: Callable[[Tensor], Tensor | None],
    names: tuple[str, ...],
) -> None:
    tensors = torch.load(drawn("aliked"), weights_only=True)
    tensors[tensor] = change(tensors[tensor])
    torch.save({each: value for each, value in tensors.items() if value is not None}, tmp_path / "other.pth")
    with refused(MethodError, tmp_path / "other.pth", None, tensor, *names):
        Aliked(tmp_path / "other.pth", 10, 1280, "cpu")


@pytest.mark.thorough
def test_remembered_features_are_those_that_the_network_finds(
    drawn: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    images = [pattern(96, 128, seed) for seed in (0, 1, 2)]
    forgetful, detector = (Aliked(drawn("aliked"), 200, 1280, "cpu", cache_size) for cache_size in (0, 2))
    passed: list[Tensor] = []
    find = detector.find

    def counted(image: Tensor) -> Any:
        passed.append(image)
        return find(image)

    monkeypatch.setattr(detector, "find", counted)
    for number, passes in [(0, 1), (0, 1), (1, 2), (0, 2), (2, 3), (0, 3), (1, 4)]:
        found, expected = detector(images[number].copy()), forgetful(images[number])
        assert len(passed) == passes, "the image used least lately is forgotten first"
        np.testing.assert_array_equal(found.uv, expected.uv)
        np.testing.assert_array_equal(found.descriptors, expected.descriptors)
    detector(images[1].reshape(128, 96, 3))
    assert len(passed) == 5, "the same bytes in another shape are another image"


def made_features(count: int, dimension: int, size: tuple[int, int], seed: int = 0) -> Features:
    rng = np.random.default_rng(seed)
    descriptors = rng.normal(size=(count, dimension)).astype(np.float32)
    descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True)
    uv = rng.uniform(0, 1, (count, 2)) * (np.array(size) - 1)
    return Features(uv, np.ones(count), np.ones(count), descriptors, size)


@pytest.mark.thorough
@pytest.mark.parametrize("dimension", [128, 256])
def test_lightglue_matches_each_feature_at_most_once(drawn: Callable[[str], Path], dimension: int) -> None:
    matcher = LightGlue(drawn(f"lightglue{dimension}"), dimension, 0.0, "cpu")
    some = made_features(60, dimension, (640, 200))
    order = np.random.default_rng(1).permutation(60)[:50]
    pairs = matcher(some, some.take(order))
    assert len(pairs) > 25
    assert len(set(pairs[:, 0].tolist())) == len(set(pairs[:, 1].tolist())) == len(pairs)
    assert np.all(np.diff(pairs[:, 0]) > 0)
    assert np.mean(pairs[:, 0] == order[pairs[:, 1]]) > 0.9, "the same descriptor at the same place"
    again = matcher(some, some.take(order))
    np.testing.assert_array_equal(pairs, again)
    scaled = Features(some.uv * 2, some.scale, some.response, some.descriptors, (1280, 400))
    np.testing.assert_array_equal(matcher(scaled, some.take(order)), pairs)  # places are relative to the image


@pytest.mark.thorough
def test_lightglue_of_nothing_is_nothing(drawn: Callable[[str], Path]) -> None:
    matcher = LightGlue(drawn("lightglue128"), 128, 0.1, "cpu")
    some, none = made_features(5, 128, (64, 64)), made_features(0, 128, (64, 64))
    assert [matcher(*pair).shape for pair in ((some, none), (none, some), (none, none))] == [(0, 2)] * 3
    with refused(MethodError, drawn("lightglue256")):
        LightGlue(drawn("lightglue256"), 128, 0.1, "cpu")


@pytest.mark.thorough
def test_loftr_of_an_image_with_itself_finds_its_cells(drawn: Callable[[str], Path]) -> None:
    network = Loftr(drawn("loftr"), "outdoor", 0.0, 840, "cpu")
    image = pattern(101, 143)
    seen = network.encode(image)
    here, there = network(seen, seen)
    assert len(here) > 10
    cells = (here + 0.5) / 8
    np.testing.assert_allclose(cells, np.rint(cells), atol=1e-6)
    assert np.median(np.abs(there - here)) <= 4.0, "the fine stage moves by 4 pixels at most"
    assert np.all(here >= 8 * 2 - 0.5), "two cells at the border have no matches"


@pytest.mark.thorough
def test_pixels_of_loftr_are_those_of_the_original(drawn: Callable[[str], Path]) -> None:
    small = pattern(96, 128)
    large = np.asarray(cv2.resize(small, None, fx=2, fy=2, interpolation=cv2.INTER_NEAREST), dtype=np.uint8)
    network = Loftr(drawn("loftr"), "outdoor", 0.0, 128, "cpu")
    direct, shrunk = network.encode(small), network.encode(large)
    plain, mixed = network(direct, direct), network(direct, shrunk)
    np.testing.assert_array_equal(plain[0], mixed[0])
    np.testing.assert_allclose((plain[1] + 0.5) * 2.0 - 0.5, mixed[1], atol=1e-9)


@pytest.mark.thorough
def test_models_of_loftr_differ_in_their_encoding_of_positions(drawn: Callable[[str], Path]) -> None:
    image = pattern(64, 96)
    maps = [Loftr(drawn("loftr"), model, 0.2, 840, "cpu").encode(image).maps for model in get_args(LoftrModel)]
    assert not torch.equal(maps[0]["coarse"], maps[1]["coarse"])
    assert torch.equal(maps[0]["fine"], maps[1]["fine"])


@pytest.mark.thorough
def test_loftr_lifts_the_cells_of_the_keyframe(drawn: Callable[[str], Path], views: tuple[Reference, Query]) -> None:
    reference, query = views
    tracker = learned_pnp.LoftrPnp(weights=drawn("loftr"), threshold=0.0)
    matches = tracker.correspond(tracker.prepare(reference), query)
    assert len(matches) > 5
    uv, valid = reference.camera.project(matches.points)
    assert valid.all()
    cells = (uv + 0.5) / 8
    np.testing.assert_allclose(cells, np.rint(cells), atol=1e-6)
    assert set(matches.scale) == {1.0}


WEIGHTS = {
    "aliked-pnp": {"weights": "aliked"},
    "aliked-lightglue-pnp": {"weights": "aliked", "matcher_weights": "lightglue128"},
    "disk-pnp": {"weights": "disk"},
    "disk-lightglue-pnp": {"weights": "disk", "matcher_weights": "lightglue128"},
    "superpoint-pnp": {"weights": "superpoint"},
    "superpoint-lightglue-pnp": {"weights": "superpoint", "matcher_weights": "lightglue256"},
    "xfeat-pnp": {"weights": "xfeat"},
    "loftr-pnp": {"weights": "loftr"},
}


@pytest.mark.thorough
@pytest.mark.parametrize("name", list(WEIGHTS))
def test_every_tracker_answers(drawn: Callable[[str], Path], views: tuple[Reference, Query], name: str) -> None:
    made = TRACKERS[name]
    given = {parameter: drawn(network) for parameter, network in WEIGHTS[name].items()}
    tracker = made(**given, min_inliers=4)
    assert made.files(**given) == given
    prepared = tracker.prepare(views[0])
    result = tracker.track(prepared, views[1])
    assert (result.confidence is None) == (made.calibration is None or not result.answered)
    again = tracker.track(prepared, views[1])
    assert (result.T_query_ref is None) == (again.T_query_ref is None)
    assert result.info == again.info


def test_trackers_are_installed_by_their_names() -> None:
    points = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"]["relocbench.methods"]
    ours = {name: target for name, target in points.items() if target.startswith("baselines.learned_pnp:")}
    assert all(issubclass(made, SupportsFetching) for made in TRACKERS.values())
    assert {name: f"baselines.learned_pnp:{made.__name__}" for name, made in TRACKERS.items()} == ours
    assert set(WEIGHTS) == set(ours)


@pytest.mark.parametrize("name", list(WEIGHTS))
def test_what_is_published_is_what_is_looked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    made = TRACKERS[name]
    places = made.published()
    assert len(places) == len(WEIGHTS[name])
    for path, file in places.items():
        assert path == tmp_path / "hub" / "checkpoints" / file.name
        assert file.address.startswith("https://")
    *_, loaded_first = WEIGHTS[name]
    with refused(MethodError, "", None, f"fetch-weights {name}", f"{name}.{loaded_first}=FILE"):
        made()
    for path in places:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    assert set(made.files().values()) == set(places)


@pytest.mark.parametrize("name", ["aliked-pnp", "disk-pnp", "xfeat-pnp", "disk-lightglue-pnp", "loftr-pnp"])
def test_without_kornia_one_line_says_what_to_install(
    drawn: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    given = {parameter: drawn(network) for parameter, network in WEIGHTS[name].items()}
    for module in [each for each in sys.modules if each.partition(".")[0] == "kornia"]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, "kornia", None)
    with refused(MethodError, "", None, "kornia", "pip install 'relocbench[learned]'"):
        TRACKERS[name](**given)
