"""Files of ``torch.save`` from strangers: what they hold is looked over before torch takes memory for it.

``torch.load(weights_only=True)`` runs no code, but it unpacks what is compressed, and calls such as ``bytearray(n)``
take as much memory as a file of a few bytes asks for. So archives must be uncompressed, as torch writes them, and may
name nothing but tensors and plain containers.
"""

from __future__ import annotations

import io
import pickletools
import warnings
import zipfile
from pathlib import Path
from typing import Any

import torch

_MOST_PICKLE_BYTES = 2**24
"""of names, shapes and plain values; a ResNet-50 with its optimiser has 100 KB"""
_ARCHIVE = b"PK\x03\x04"
_LEGACY_PICKLES = 5
"""that the format of torch before 1.6 begins with: mark, version, system, content, keys"""
_NAMES = {
    ("collections", "OrderedDict"),
    ("torch._utils", "_rebuild_tensor_v2"),
    ("torch._utils", "_rebuild_parameter"),
    ("torch", "Size"),
    *(("torch", f"{kind}Storage") for kind in
      ("Float", "Double", "Half", "BFloat16", "Long", "Int", "Short", "Char", "Byte", "Bool")),
}  # fmt: skip


def load_torch_file(path: Path) -> Any:
    """What was saved, with tensors on the CPU.

    Raises:
        ValueError: no plain file, not of ``torch.save``, damaged, compressed, or with something else than tensors and
            plain values; in words.
    """
    if not path.is_file():
        raise ValueError("no plain file")
    try:
        with path.open("rb") as stream:
            archived = stream.read(4) == _ARCHIVE
        if archived:
            _check_names(_pickle_of_archive(path), 1)
        else:
            _check_names(path.read_bytes(), _LEGACY_PICKLES)
        with warnings.catch_warnings(action="ignore"):  # of a file that is refused anyway
            return torch.load(path, map_location="cpu", weights_only=True)
    # What archives and pickles raise on foreign bytes is not listed anywhere.
    except Exception as bad:
        told = bad.args[0] if isinstance(bad, _Refused) else "damaged, cut short, or of another program"
        raise ValueError(told) from bad


class _Refused(Exception):
    """With the reason."""


def _pickle_of_archive(path: Path) -> bytes:
    with zipfile.ZipFile(path) as archive:
        entries = archive.infolist()
        if any(e.compress_type != zipfile.ZIP_STORED or e.file_size != e.compress_size for e in entries):
            raise _Refused("it is compressed, which torch.save does not do")
        if sum(entry.file_size for entry in entries) > path.stat().st_size:
            raise _Refused("its entries are larger than the file")
        pickles = [entry for entry in entries if entry.filename.endswith("/data.pkl")]
        if len(pickles) != 1 or pickles[0].file_size > _MOST_PICKLE_BYTES:
            raise _Refused("it has no list of tensors, or one that is too long")
        return archive.read(pickles[0])


def _check_names(data: bytes, pickles: int) -> None:
    """Raises _Refused where pickles name something else than tensors and containers."""
    stream = io.BytesIO(data)
    for _ in range(pickles):
        for operation, argument, _at in pickletools.genops(stream):
            if operation.name in ("STACK_GLOBAL", "INST", "EXT1", "EXT2", "EXT4"):
                raise _Refused("it holds something else than tensors and plain values")
            if operation.name == "GLOBAL" and tuple(str(argument).split(" ", 1)) not in _NAMES:
                raise _Refused("it holds something else than tensors and plain values")
