"""What a training was made with: software and hardware, for model cards."""

from __future__ import annotations

import platform
from importlib import metadata
from pathlib import Path

import torch

from relocbench import version


def versions() -> dict[str, str]:
    """Versions of what training depends on."""
    known = {name: metadata.version(name) for name in ("torch", "numpy", "opencv-python-headless", "numba")}
    return {"relocbench": version.__version__, "python": platform.python_version(), **known}


def hardware(device: torch.device) -> str:
    """Processor, threads and GPU in words."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    words = f"{(names or [platform.machine()])[0]}, {torch.get_num_threads()} threads"
    return f"{words}; {torch.cuda.get_device_name(device)}" if device.type == "cuda" else words
