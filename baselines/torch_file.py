"""Untrusted files of ``torch.save``: their content is checked before torch allocates memory for it.

``torch.load(weights_only=True)`` runs no code, but it decompresses entries, and calls such as ``bytearray(n)`` in a
file of a few bytes can allocate any amount of memory. Therefore archives must be uncompressed, as torch writes them,
and may name only tensors and plain containers.
"""

from __future__ import annotations

import io
import pickletools
import warnings
import zipfile
from pathlib import Path
from typing import Any

import torch

from relocbench.pointers import pointer_fault

_MOST_PICKLE_BYTES = 2**24
"""for names, shapes and plain values; a ResNet-50 with its optimiser has 100 KB"""
_ARCHIVE = b"PK\x03\x04"
_LEGACY_PICKLES = 5
"""number of pickles that a file of torch before 1.6 begins with: magic number, version, system, content, keys"""
_NAMES = {
    ("collections", "OrderedDict"),
    ("torch._utils", "_rebuild_tensor_v2"),
    ("torch._utils", "_rebuild_parameter"),
    ("torch", "Size"),
    *(("torch", f"{kind}Storage") for kind in
      ("Float", "Double", "Half", "BFloat16", "Long", "Int", "Short", "Char", "Byte", "Bool")),
}  # fmt: skip


def load_torch_file(path: Path) -> Any:
    """The saved object, with tensors on the CPU.

    Raises:
        ValueError: the file is not regular, not of ``torch.save``, damaged, compressed, or holds something other than
            tensors and plain values; the message says which.
    """
    if not path.is_file():
        raise ValueError("no regular file")
    pointer = pointer_fault(path)
    if pointer is not None:
        raise ValueError(pointer)
    try:
        with path.open("rb") as stream:
            archived = stream.read(4) == _ARCHIVE
        if archived:
            _check_names(_pickle_of_archive(path), 1)
        else:
            _check_names(path.read_bytes(), _LEGACY_PICKLES)
        with warnings.catch_warnings(action="ignore"):  # about files that are refused anyway
            return torch.load(path, map_location="cpu", weights_only=True)
    # It is nowhere documented what archives and pickles raise on arbitrary bytes.
    except Exception as bad:
        reason = bad.args[0] if isinstance(bad, _Refused) else "damaged, cut short, or of another program"
        raise ValueError(reason) from bad


class _Refused(Exception):
    """The file is refused; the argument is the reason."""


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
    """Raise _Refused if the pickles name anything but tensors and containers."""
    stream = io.BytesIO(data)
    for _ in range(pickles):
        for operation, argument, _at in pickletools.genops(stream):
            if operation.name in ("STACK_GLOBAL", "INST", "EXT1", "EXT2", "EXT4"):
                raise _Refused("it holds something other than tensors and plain values")
            if operation.name == "GLOBAL" and tuple(str(argument).split(" ", 1)) not in _NAMES:
                raise _Refused("it holds something other than tensors and plain values")
