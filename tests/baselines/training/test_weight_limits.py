"""Weights, checkpoints and correspondences from strangers: refused in one line, before memory is taken for them."""

from __future__ import annotations

import io
import json
import pickle
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch
from refusals import refused
from torch import nn

from baselines.gn_net import weights as gn_net
from baselines.gn_net.network import FeatureNet
from baselines.gn_net.options import NetworkOptions
from baselines.lpn import weights as lpn
from baselines.lpn.backbone import make_backbone
from baselines.lpn.backbone_weights import load_backbone
from baselines.training.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from baselines.training.checkpoint_content import check_state, restore_optimiser
from relocbench.datasets.pairs.correspondence_file import MOST_ROWS, SCHEMA, CorrespondenceIndex, read_correspondences
from relocbench.errors import DatasetError, MethodError

GN_NET = {"card": {}, "version": 1, "options": {}}
LPN = {
    "version": 1, "classes": 3, "network": {"backbone": "resnet18"}, "configuration": "x", "size": 256,
    "backbone_start": "x", "views": ["drone"], "card": {},
}  # fmt: skip


def safetensors(header: Any, body: bytes = b"", length: int | None = None) -> bytes:
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return struct.pack("<Q", len(text) if length is None else length) + text + body


def one_tensor(shape: list[Any], dtype: str = "F32", offsets: tuple[int, int] = (0, 4)) -> bytes:
    return safetensors({"a": {"dtype": dtype, "shape": shape, "data_offsets": offsets}}, bytes(4))


def describing(kind: str, about: Any) -> bytes:
    text = about if isinstance(about, str) else json.dumps(about)
    return safetensors(
        {"__metadata__": {kind: text}, "a": {"dtype": "F32", "shape": [1], "data_offsets": (0, 4)}}, bytes(4)
    )


def gn_net_of(**options: Any) -> bytes:
    return describing("gn-net", {**GN_NET, "options": options})


def lpn_of(network: dict[str, Any] | None = None, **about: Any) -> bytes:
    return describing("lpn", {**LPN, **about, "network": {**LPN["network"], **(network or {})}})  # type: ignore[dict-item]


WEIGHTS: dict[str, tuple[Callable[[Path], Any], bytes, str]] = {
    "a header of 2^63 bytes": (gn_net.load_weights, safetensors({}, length=2**63), "not a readable safetensors file"),
    "a header of 90 MB": (gn_net.load_weights, safetensors({}, length=90_000_000), "not a readable safetensors file"),
    "10^12 numbers": (gn_net.load_weights, one_tensor([10**6, 10**6]), "not a readable safetensors file"),
    "more than 64 bits": (gn_net.load_weights, one_tensor([2**63, 2**63]), "not a readable safetensors file"),
    "beyond the file": (gn_net.load_weights, one_tensor([10**9], offsets=(0, 4 * 10**9)), "not a readable safetensors"),
    "backwards": (gn_net.load_weights, one_tensor([1], offsets=(4, 0)), "not a readable safetensors file"),
    "an odd type": (gn_net.load_weights, one_tensor([1], "F31"), "not a readable safetensors file"),
    "brackets": (gn_net.load_weights, safetensors(b"[" * 100_000), "not a readable safetensors file"),
    "empty": (gn_net.load_weights, b"", "not a readable safetensors file"),
    "brackets in the metadata": (gn_net.load_weights, describing("gn-net", "[" * 100_000), "not weights of gn-net"),
    "5000 digits": (gn_net.load_weights, describing("gn-net", "9" * 5000), "not weights of gn-net"),
    "channels of 10^9": (gn_net.load_weights, gn_net_of(widths=[10**9], levels=1), "at most 12, none above 8192"),
    "10^5 stages": (gn_net.load_weights, gn_net_of(widths=[1] * 10**5, levels=1), "at most 12, none"),
    "a square of 2^1000": (gn_net.load_weights, gn_net_of(finest=1000), "finest is 1000"),
    "dim of 10^9": (gn_net.load_weights, gn_net_of(dim=10**9), "dim is 1000000000"),
    "a network of 5 GB": (gn_net.load_weights, gn_net_of(widths=[8192, 8192], levels=1), "numbers or more; it holds 1"),
    "options of another type": (gn_net.load_weights, gn_net_of(widths="many"), "options are not understood"),
    "10^12 classes": (lpn.load_weights, lpn_of(classes=10**12), "numbers or more; it holds 1"),
    "a word for classes": (lpn.load_weights, lpn_of(classes="many"), "is not understood"),
    "a list for the network": (lpn.load_weights, describing("lpn", {**LPN, "network": [1, 2]}), "is not understood"),
    "10^9 parts": (lpn.load_weights, lpn_of({"parts": 10**9}), "parts is 1000000000, expected 1 to 256"),
    "width of 10^9": (lpn.load_weights, lpn_of({"width": 10**9}), "width is 1000000000, expected 1 to 65536"),
    "an attention over 10^9": (lpn.load_weights, lpn_of({"attention": {"kernel": 10**9 + 1}}), "up to 255"),
    "10^9 hidden channels": (lpn.load_weights, lpn_of({"heatmap": {"hidden": 10**9}}), "expected 1 to 4096 channels"),
    "images of 10^9 pixels": (lpn.load_weights, lpn_of(size=10**9), "size is 1000000000, expected 1 to 4096"),
}  # fmt: skip


def assert_one_line(caught: pytest.ExceptionInfo[Exception], path: Path, words: str) -> None:
    assert words in str(caught.value)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


@pytest.fixture
def no_network(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fails the test that makes a network."""

    def refuse(*_: Any, **__: Any) -> None:
        raise AssertionError("a network was made")

    monkeypatch.setattr(gn_net, "FeatureNet", refuse)
    monkeypatch.setattr(lpn, "LpnNetwork", refuse)


@pytest.mark.parametrize("case", WEIGHTS)
def test_weights_that_ask_for_too_much_are_refused_before_a_network_is_made(
    tmp_path: Path, case: str, no_network: None
) -> None:
    load, data, words = WEIGHTS[case]
    path = tmp_path / "weights.safetensors"
    path.write_bytes(data)
    with pytest.raises(MethodError) as caught:
        load(path)
    assert_one_line(caught, path, words)


def test_a_network_of_its_own_weights_passes_the_bound_on_numbers(tmp_path: Path) -> None:
    options = NetworkOptions(widths=(3, 5), levels=2, finest=0, dim=2)
    net = FeatureNet(options)
    assert options.least_parameters <= net.parameters_count
    gn_net.save_weights(tmp_path / "a.safetensors", net, {})
    assert gn_net.load_weights(tmp_path / "a.safetensors").options == options


class Large:
    """Pickled as a call that takes memory."""

    def __reduce__(self) -> tuple[type, tuple[int]]:
        return bytearray, (2**36,)


class Code:
    """Pickled as a call of the system."""

    def __reduce__(self) -> tuple[Any, tuple[str]]:
        import os

        return os.system, ("true",)


def saved(content: Any, **how: Any) -> bytes:
    stream = io.BytesIO()
    torch.save(content, stream, **how)
    return stream.getvalue()


def packed_anew(data: bytes, compression: int = zipfile.ZIP_STORED, **entries: bytes) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as given, zipfile.ZipFile(out, "w", compression) as archive:
        for name in given.namelist():
            archive.writestr(name, entries.get(name.split("/", 1)[1].replace(".", "_"), given.read(name)))
    return out.getvalue()


ZEROS = saved({"a": torch.zeros(1_000_000)})
with zipfile.ZipFile(io.BytesIO(ZEROS)) as _archive:
    LARGER = _archive.read("archive/data.pkl").replace(struct.pack("<i", 1_000_000), struct.pack("<i", 2**31 - 1))
NOT_LOADED = {
    "code": saved(Code()),
    "a call that takes 64 GB": saved(Large()),
    "the same in the format of before": saved(Large(), _use_new_zipfile_serialization=False),
    "a bomb": packed_anew(ZEROS, zipfile.ZIP_DEFLATED),
    "a tensor larger than its numbers": packed_anew(ZEROS, data_pkl=LARGER),
    "cut": ZEROS[:-500],
    "its head alone": ZEROS[:100],
    "a plain pickle": pickle.dumps({"a": 1}),
    "text": b"weights",
    "empty": b"",
}  # fmt: skip


@pytest.mark.parametrize("case", NOT_LOADED)
def test_what_torch_would_run_unpack_or_fill_is_refused(tmp_path: Path, case: str) -> None:
    path = tmp_path / "a.pth"
    path.write_bytes(NOT_LOADED[case])
    with pytest.raises(MethodError) as caught:
        load_checkpoint(path, {})
    assert_one_line(caught, path, "not a whole checkpoint (")
    with pytest.raises(MethodError) as caught:
        load_backbone(path, make_backbone("resnet18", 1, torch.Generator()))
    assert_one_line(caught, path, "cannot be read as weights: ")


@pytest.mark.thorough
@pytest.mark.parametrize("archived", [True, False])
def test_backbones_of_both_formats_of_torch_are_read(tmp_path: Path, archived: bool) -> None:
    given, taken = (make_backbone("resnet18", 1, torch.Generator().manual_seed(seed)) for seed in (1, 2))
    path = tmp_path / "a.pth"
    path.write_bytes(saved(given.state_dict(), _use_new_zipfile_serialization=archived))
    load_backbone(path, taken)
    assert all(torch.equal(value, taken.state_dict()[name]) for name, value in given.state_dict().items())


def checkpoint(tmp_path: Path) -> tuple[nn.Module, torch.optim.AdamW, Path, dict[str, Any]]:
    net = nn.Linear(3, 2)
    optimiser = torch.optim.AdamW(net.parameters())
    net(torch.ones(1, 3)).sum().backward()
    optimiser.step()
    path = tmp_path / "checkpoint.pt"
    found = Checkpoint({"a": 1}, 5, net.state_dict(), optimiser.state_dict(), None, {"loss": 1.0}, 2, 3.0, None, [])
    save_checkpoint(path, found)
    return net, optimiser, path, torch.load(path, weights_only=True)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"net": None}, ": net: "),
        ({"step": "five"}, ": step: "),
        ({"step": True}, ": step: "),
        ({"step": -1}, ": step: "),
        ({"identity": [1]}, ": identity: "),
        ({"window": {"loss": "low"}}, ": window.loss: "),
        ({"net": {"weight": 1}}, ": net.weight: "),
        ({"best": {}}, ": best.step: "),
        ({"best": {"step": 1, "score": 1.0, "weights": {}, "scores": {"other": 1}}}, ": best.scores: "),
        ({"more": 1}, ": more: "),
        ({"version": 7}, "a checkpoint of another version"),
    ],
)
def test_a_checkpoint_with_other_entries_is_refused_by_name(tmp_path: Path, change: dict[str, Any], words: str) -> None:
    _, _, path, values = checkpoint(tmp_path)
    assert load_checkpoint(path, {"a": 1}) is not None
    path.write_bytes(saved({**values, **change}))
    with pytest.raises(MethodError) as caught:
        load_checkpoint(path, {"a": 1})
    assert_one_line(caught, path, words)


@pytest.mark.parametrize("key", ["identity", "step", "net", "optimiser", "window", "best", "messages"])
def test_a_checkpoint_without_an_entry_is_refused_by_name(tmp_path: Path, key: str) -> None:
    _, _, path, values = checkpoint(tmp_path)
    path.write_bytes(saved({name: value for name, value in values.items() if name != key}))
    with refused(MethodError, path, None, key):
        load_checkpoint(path, {"a": 1})


def test_the_state_of_another_network_or_optimiser_is_refused(tmp_path: Path) -> None:
    net, optimiser, path, values = checkpoint(tmp_path)
    check_state(net, values["net"], path)
    restore_optimiser(optimiser, values["optimiser"], path)
    endless = torch.zeros(1).expand(10**6, 10**6)  # one number in the file
    for state in ({"weight": endless, "bias": values["net"]["bias"]}, {"weight": values["net"]["weight"]}):
        with refused(MethodError, path):
            check_state(net, state, path)
    groups = values["optimiser"]["param_groups"]
    other: dict[str, Any]
    for other in (
        {},
        {"param_groups": [], "state": {}},
        {"param_groups": [{"params": [0, 1]}], "state": {}},
        {"param_groups": [{**groups[0], "lr": "low"}], "state": {}},
        {"param_groups": groups, "state": {9: {}}},
        {"param_groups": groups, "state": {0: {"exp_avg": endless}}},
    ):
        with refused(MethodError, path):
            restore_optimiser(optimiser, other, path)


def column(field: pa.Field) -> pa.Array:
    if field.name == "check":
        return pa.array(["both"] * 3).dictionary_encode()
    return pa.array([1] * 3).cast(field.type)


ROWS = pa.table({field.name: column(field) for field in SCHEMA})


def with_column(name: str, values: Any) -> pa.Table:
    return ROWS.set_column(ROWS.column_names.index(name), name, values)


def many_rows() -> pa.Table:
    """Equal rows, which take a few bytes."""
    rows = MOST_ROWS + 1
    columns = {name: pa.repeat(ROWS[name][0], rows) for name in ROWS.column_names if name != "check"}
    check = pa.DictionaryArray.from_arrays(pa.repeat(pa.scalar(0, pa.int8()), rows), ["both"])
    return pa.table({name: columns.get(name, check) for name in ROWS.column_names})


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (lambda: with_column("u_ref", pa.array(["a"] * 3)), "column 'u_ref' is string, expected float"),
        (lambda: with_column("u_ref", pa.array([[1.0]] * 3)), "column 'u_ref' is list, expected float"),
        (lambda: with_column("visible", pa.array([{"a": 1}] * 3)), "column 'visible' is struct, expected bool"),
        (lambda: with_column("ref_timestamp_ns", pa.array([1.5] * 3)), "column 'ref_timestamp_ns' is double, expected"),
        (lambda: with_column("check", pa.array([1] * 3)), "column 'check' is int64, expected dictionary"),
        (
            lambda: with_column("v_ref", pa.array([1, None, 2], pa.float32())),
            "column 'v_ref' has 1 rows without a value",
        ),
        (lambda: ROWS.select(["u_ref"]), "expected the columns"),
        (many_rows, f"row group 0 has {MOST_ROWS + 1} rows; a pair has at most {MOST_ROWS}"),
    ],
)
def test_correspondences_of_other_types_or_of_endless_rows_are_refused(
    tmp_path: Path, table: Callable[[], pa.Table], words: str
) -> None:
    path = tmp_path / "a.parquet"
    pq.write_table(table(), path, compression="zstd", row_group_size=2 * MOST_ROWS)
    with pytest.raises(DatasetError) as caught:
        read_correspondences(path)
    assert_one_line(caught, path, words)


def test_correspondences_that_do_not_tell_their_pair_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    pq.write_table(ROWS, path, write_statistics=False)
    assert len(read_correspondences(path)) == 3
    for read in (lambda: read_correspondences(path, (1, 1)), lambda: CorrespondenceIndex(path)):
        with refused(DatasetError, path):
            read()


def test_damaged_correspondences_are_one_line_or_read(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    pq.write_table(ROWS, path, compression="zstd")
    whole, rng = path.read_bytes(), np.random.default_rng(0)
    messages = []
    for _ in range(100):
        data = bytearray(whole)
        for at in rng.integers(0, len(data), 3):
            data[at] = rng.integers(256)
        path.write_bytes(bytes(data))
        try:
            read_correspondences(path)
        except DatasetError as bad:
            messages.append(str(bad))
    assert len(messages) > 10
    assert not [message for message in messages if "\n" in message]
