"""Options of a small LPN, and what its file says, for tests of what is made of its descriptors."""

from __future__ import annotations

from baselines.lpn.options import NetworkOptions
from baselines.lpn.weights import About

NARROW = NetworkOptions(backbone="resnet18", width=8)
ABOUT = About("lpn", 64, "drawn, no ImageNet", ("drone", "satellite"), 0, {"data": '{"made": "0"}'})
