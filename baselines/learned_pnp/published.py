"""The files of weights that the authors of the networks publish, as of November 2026.

None of the publishers states a digest. Each one here is that of the file in several projects that pin it independently.
"""

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
        ("n16rot", "ddf3abbf38e86f6a74540d214e1a9712c54b2d8551abc864542199f2347d7332", None),
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
    sha256="9c2ee4ded238892dfa51569941372601e35e4a74aa6f84ea80053d2ab1c07abe",
    size_bytes=4375832,
)

XFEAT = PublishedFile(
    name="xfeat.pt",
    address="https://github.com/verlab/accelerated_features/raw/main/weights/xfeat.pt",
    publisher="verlab/accelerated_features (Potje et al.)",
    licence="Apache-2.0",
    sha256="0f5187fd7bedd26c7fe6acc9685444493a165a35ecc087b33c2db3627f3ea10b",
    size_bytes=6247949,
)

SUPERPOINT = PublishedFile(
    name="superpoint_v1.pth",
    address=f"{_RELEASE}/superpoint_v1.pth",
    publisher="cvg/LightGlue, release v0.1_arxiv; the work of Magic Leap (DeTone et al.)",
    licence="Magic Leap's: academic or non-profit, non-commercial research only",
    sha256="52b6708629640ca883673b5d5c097c4ddad37d8048b33f09c8ca0d69db12c40e",
    size_bytes=5206086,
)

LIGHTGLUE = {
    features: PublishedFile(
        name=f"{features}_lightglue_v0-1_arxiv.pth",
        address=f"{_RELEASE}/{features}_lightglue.pth",
        publisher=_LIGHTGLUE,
        licence="Apache-2.0",
        sha256=sha256,
        size_bytes=size_bytes,
    )
    for features, sha256, size_bytes in (
        ("aliked", "d975e965b105311a6143194852297dff4f02aea5cc2e10cecfed966ca0e22503", 47632827),
        ("disk", "b5b21d47ea24f2c5e501aec9c91b9716e4c8c3429a4dc1e615c133c4c9378335", 47631405),
        ("superpoint", "6ff7040d0a497fc6639337946d7538dae07428c18f77a067a0b5a960e7cc551a", None),
    )
}
"""by the features that they match, under the names that kornia keeps them by"""

LOFTR = {
    model: PublishedFile(
        name=name,
        address=f"https://cmp.felk.cvut.cz/~mishkdmy/models/{name}",
        publisher="a maintainer of kornia; the work of zju3dv/LoFTR (Sun et al.)",
        licence="Apache-2.0",
        sha256=sha256,
        size_bytes=size_bytes,
    )
    for model, name, sha256, size_bytes in (
        (
            "outdoor",
            "loftr_outdoor.ckpt",
            "21f5bec5968178e8bc8b7633441836fe5de4f47d861dd2cd7dc38e271b0479ec",
            46341978,
        ),
        (
            "indoor_new",
            "loftr_indoor_ds_new.ckpt",
            "be9ff88b323ec27889114719f668ae41aff7034b56a4c4acbd46b8b180b87ed3",
            None,
        ),
    )
}
"""by model"""
