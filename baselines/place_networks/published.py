"""The files of weights that the authors of the networks publish, as of November 2026.

Digests are Patch-NetVLAD's publisher's, and for MegaLoc that of several projects that pin it independently.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from baselines.place_networks.backbone import BackboneName
from relocbench.errors import MethodError
from relocbench.weights import PublishedFile

Dimensions = Mapping[BackboneName, tuple[int, ...]]
NetVladModel = Literal[
    "pitts_WPCA128",
    "pitts_WPCA512",
    "pitts_WPCA4096",
    "mapillary_WPCA128",
    "mapillary_WPCA512",
    "mapillary_WPCA4096",
    "landmarks_WPCA4096",
]

_LARGE = (32, 64, 128, 256, 512, 1024, 2048)
COSPLACE: Dimensions = {
    "VGG16": (64, 128, 256, 512),
    "ResNet18": (32, 64, 128, 256, 512),
    "ResNet50": _LARGE,
    "ResNet101": _LARGE,
    "ResNet152": _LARGE,
}
EIGENPLACES: Dimensions = {
    "VGG16": (512,),
    "ResNet18": (256, 512),
    "ResNet50": (128, 256, 512, 2048),
    "ResNet101": (128, 256, 512, 2048),
}


def cosplace(backbone: BackboneName, dimensions: int) -> PublishedFile:
    """CosPlace's file of a backbone and a number of dimensions. Raises MethodError if there is none."""
    return _of_berton("CosPlace", COSPLACE, backbone, dimensions, "that of gmberton/CosPlace, in its file LICENSE")


def eigenplaces(backbone: BackboneName, dimensions: int) -> PublishedFile:
    """EigenPlaces' file of a backbone and a number of dimensions. Raises MethodError if there is none."""
    return _of_berton("EigenPlaces", EIGENPLACES, backbone, dimensions, "MIT")


def _of_berton(method: str, known: Dimensions, backbone: BackboneName, dimensions: int, licence: str) -> PublishedFile:
    if dimensions not in known.get(backbone, ()):
        available = "; ".join(f"{name}: {', '.join(map(str, sizes))}" for name, sizes in known.items())
        raise MethodError(
            f"there are no weights of {method} on {backbone} with {dimensions} dimensions; available: {available}"
        )
    name = f"{backbone}_{dimensions}_{method.lower()}.pth"
    return PublishedFile(
        name=name,
        address=f"https://github.com/gmberton/{method}/releases/download/v1.0/{name}",
        publisher=f"gmberton/{method}, release v1.0 (Berton et al.)",
        licence=licence,
    )


_PATCH_NETVLAD: Mapping[NetVladModel, tuple[str, int | None]] = {
    "pitts_WPCA128": ("74bb0e0113c074ed9b07651a5f01bd424171d8e3b91d7024d2ccb0b0392164f3", 92681537),
    "pitts_WPCA512": ("309611d927c759e897e1eb27977994236b5618d9d3cd7202035cea1b56c08c1c", None),
    "pitts_WPCA4096": ("2c3cf17de91974156cb6aee40a6f7a229825095273d7de87c0792084ae1bf4aa", 1132901186),
    "mapillary_WPCA128": ("5b6de8a5537061bbe7a477b62bb687b042d92d472e5231e2072026ecc59ec4b1", 67319611),
    "mapillary_WPCA512": ("acbe2597c1c23c95482883c05969006a74bf7e68c4151dbb4ab5d67b69e8e346", 92488008),
    "mapillary_WPCA4096": ("4b22ad1619bb7f085a5229d35f0f865740f2cdad2bced2ddbc7b28791c5b1542", 327398210),
    "landmarks_WPCA4096": ("659a837b11883ed8a8ea5e1d1a46eb2871ea26514fbfc2ad7d9d4e1334380a34", None),
}
"""SHA-256 and bytes, as the publisher states them"""

NETVLAD: Mapping[NetVladModel, PublishedFile] = {
    model: PublishedFile(
        name=f"{model}.pth.tar",
        address=f"https://huggingface.co/TobiasRobotics/Patch-NetVLAD/resolve/main/{model}.pth.tar",
        publisher="TobiasRobotics/Patch-NetVLAD (Hausler et al.)",
        licence="MIT",
        sha256=sha256,
        size_bytes=size_bytes,
    )
    for model, (sha256, size_bytes) in _PATCH_NETVLAD.items()
}
"""by model"""

MEGALOC = PublishedFile(
    name="megaloc.safetensors",
    address="https://huggingface.co/gberton/MegaLoc/resolve/7cb9f7970d366fdf059963d04d372e503e8e9df9/model.safetensors",
    publisher="gberton/MegaLoc on Hugging Face (Berton and Masone)",
    licence="MIT",
    sha256="d4f9f2bcb60018f91eb6a8e061ed054fd55654e10c2569cf13841ea986ffb4f8",
    size_bytes=914577436,
)
