"""OpenVINO in place of torch: the same maps and poses, and one line where it cannot be had."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
from refusals import refused
from small_dataset import render, small_camera, small_pose

from baselines.gn_net.engine import on_engine
from baselines.gn_net.network import FeatureNet
from baselines.gn_net.options import NetworkOptions
from baselines.gn_net.tracker import GnNet
from relocbench.errors import MethodError
from relocbench.geometry import apply
from relocbench.methods import parse_method
from relocbench.tracking import Query, Reference

SMALL = NetworkOptions(widths=(8, 12, 16), dim=8, levels=3)
LITE = replace(SMALL, encoder="efficientnet-lite0", confidence=True)
SIZE = 192, 144


def needs_openvino() -> None:
    pytest.importorskip("openvino", reason="the extra 'fast' is not installed")


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("options", "asked"),
    [(SMALL, [((1, 1, 37, 50), 0)]), (LITE, [((1, 3, 48, 64), 0), ((1, 3, 48, 64), 2)])],
    ids=["plain", "efficientnet-lite0"],
)
def test_maps_are_those_of_torch(options: NetworkOptions, asked: list[tuple[tuple[int, ...], int]]) -> None:
    needs_openvino()
    net = FeatureNet(options).eval()
    by_torch, by_openvino = on_engine(net, "torch", "cpu"), on_engine(net, "openvino", "cpu")
    generator = torch.Generator().manual_seed(0)
    for shape, first in asked:
        images = torch.rand(shape, generator=generator)
        with torch.inference_mode():
            expected, found = (each.with_confidences(images, first) for each in (by_torch, by_openvino))
        for ours, theirs in zip(expected, found, strict=True):
            assert len(ours) == len(theirs)
            for one, other in zip(ours, theirs, strict=True):
                torch.testing.assert_close(other, one, rtol=0, atol=1e-5 * float(one.abs().max()))


@pytest.mark.thorough
def test_the_shipped_weights_give_the_same_pose() -> None:
    needs_openvino()
    camera = small_camera(*SIZE)
    image, depth = render(camera, small_pose(0))
    reference = Reference(key="r", timestamp_ns=1, image=image, camera=camera, depth=depth)
    query = Query(key="q", timestamp_ns=2, image=render(camera, small_pose(3))[0], camera=camera)
    seen = []
    for settings in ((), ("engine=openvino",)):
        tracker: GnNet = parse_method("gn-net", settings).create()
        prepared = tracker.prepare(reference)
        found = tracker.track(prepared, query)
        assert found.T_query_ref is not None
        pixels, _ = camera.project(apply(found.T_query_ref, prepared.landmarks.points))
        seen.append(pixels)
    assert np.nanmax(np.linalg.norm(seen[0] - seen[1], axis=1)) < 1e-2


def test_images_that_are_too_small_are_refused_as_by_torch() -> None:
    needs_openvino()
    net = on_engine(FeatureNet(SMALL), "openvino", "cpu")
    with refused(ValueError, "", None, "5x5", "8x8"):
        net.with_confidences(torch.zeros(1, 3, 5, 5))


SIGNAL_AFTER_NETWORKS = """
import faulthandler, gc, signal
faulthandler.enable()
import torch
from baselines.gn_net.engine import on_engine
from baselines.gn_net.network import FeatureNet
from baselines.gn_net.options import NetworkOptions
made = [on_engine(FeatureNet(NetworkOptions(widths=(4,), dim=2, levels=1)), "openvino", "cpu") for _ in range(2)]
for net in made:
    net.with_confidences(torch.zeros(1, 3, 16, 16))
del net
while made:
    made.pop(0)
    gc.collect()
signal.signal(signal.SIGUSR1, lambda number, frame: print("handled"))
signal.raise_signal(signal.SIGUSR1)
"""


@pytest.mark.thorough
def test_a_signal_is_handled_after_networks_have_gone() -> None:
    needs_openvino()
    done = subprocess.run([sys.executable, "-c", SIGNAL_AFTER_NETWORKS], check=False, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "handled\n"), done.stderr


def test_without_the_package_one_line_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "openvino", None)
    with refused(MethodError, "", None, "openvino", "relocbench[fast]"):
        parse_method("gn-net", ["engine=openvino"]).create()


def test_another_device_is_refused() -> None:
    with refused(MethodError, "", None, "openvino", "cuda", "cpu"):
        on_engine(FeatureNet(SMALL), "openvino", "cuda")
