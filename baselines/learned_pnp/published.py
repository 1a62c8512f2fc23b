"""The files of weights that the authors of the networks publish, as of November 2026."""

from __future__ import annotations

from relocbench.weights import PublishedFile

_LIGHTGLUE = "cvg/LightGlue, release v0.1_arxiv (Lindenberger et al.)"
_RELEASE = "https://github.com/cvg/LightGlue/releases/download/v0.1_arxiv"

ALIKED = {
    model: PublishedFile(
        name=f"aliked-{model}.pth",
        address=f"https://github.com/Shiaoming/ALIKED/raw/main/models/aliked-{model}.pth",
        publisher="Shiaoming/ALIKED (Zhao et al.)",
        licence="BSD-3-Clause",
        sha256=sha256,
        size_bytes=size_bytes,
    )
    for model, sha256, size_bytes in (
        ("n16", "5be8704840ed662d9d8c561bf7279c222092674e7eb05fd0feab94899e9d82f2", 2738091),
        ("n16rot", None, None),
        ("n32", "055283fd1624d3ab46a05c3b617b1a79a3f28d1f551737eef2d653e8c8232890", 3946667),
        ("t16", "56782336919db220144a884e710e2b6af13b3b8f8da15b915a239078ab471085", 794859),
    )
}
"""by model"""

DISK = PublishedFile(
    name="depth-save.pth",
    address="https://raw.githubusercontent.com/cvlab-epfl/disk/master/depth-save.pth",
    publisher="cvlab-epfl/disk (Tyszkiewicz et al.)",
    licence="Apache-2.0",
)

XFEAT = PublishedFile(
    name="xfeat.pt",
    address="https://github.com/verlab/accelerated_features/raw/main/weights/xfeat.pt",
    publisher="verlab/accelerated_features (Potje et al.)",
    licence="Apache-2.0",
)

SUPERPOINT = PublishedFile(
    name="superpoint_v1.pth",
    address=f"{_RELEASE}/superpoint_v1.pth",
    publisher="cvg/LightGlue, release v0.1_arxiv; the work of Magic Leap (DeTone et al.)",
    licence="Magic Leap's: academic or non-profit, non-commercial research only",
)

LIGHTGLUE = {
    features: PublishedFile(
        name=f"{features}_lightglue_v0-1_arxiv.pth",
        address=f"{_RELEASE}/{features}_lightglue.pth",
        publisher=_LIGHTGLUE,
        licence="Apache-2.0",
    )
    for features in ("aliked", "disk", "superpoint")
}
"""by the features that they match, under the names that kornia keeps them by"""

LOFTR = {
    model: PublishedFile(
        name=name,
        address=f"https://cmp.felk.cvut.cz/~mishkdmy/models/{name}",
        publisher="a maintainer of kornia; the work of zju3dv/LoFTR (Sun et al.)",
        licence="Apache-2.0",
    )
    for model, name in (("outdoor", "loftr_outdoor.ckpt"), ("indoor_new", "loftr_indoor_ds_new.ckpt"))
}
"""by model"""
