"""NumPy files from bytes; the declared size is compared with the real one before memory is allocated."""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy_format
from numpy.typing import NDArray

from relocbench.errors import DatasetError

_HEADERS = {(1, 0): npy_format.read_array_header_1_0, (2, 0): npy_format.read_array_header_2_0}
_MOST_HEADER = 10_000
"""characters; NumPy's own limit"""


def parse_npy(data: bytes, path: Path) -> NDArray[Any]:
    """The array of a ``.npy`` file of numbers, or of records of numbers.

    Raises:
        DatasetError: it is not such a file, holds objects or text, or has fewer bytes than its shape needs.
    """
    stream = io.BytesIO(data)
    try:
        version = npy_format.read_magic(stream)
        shape, in_columns, dtype = _HEADERS[version](stream, max_header_size=_MOST_HEADER)
    # The header is a Python literal, and which errors parsing arbitrary text as one raises is not documented.
    except Exception as bad:
        raise DatasetError("cannot be read as a NumPy array", path) from bad
    kinds = [dtype[name].base for name in dtype.names] if dtype.names else [dtype]
    if any(kind.kind not in "iuf" for kind in kinds):
        raise DatasetError("holds values other than integers and floats; expected a NumPy array of numbers", path)
    count, left = math.prod(shape), len(data) - stream.tell()
    if min(shape, default=0) < 0 or count * dtype.itemsize > left:
        raise DatasetError(f"is truncated: its header promises {count} entries of {dtype.itemsize} bytes", path)
    values = np.frombuffer(data, dtype=dtype, count=count, offset=stream.tell()) if count else np.empty(0, dtype)
    return values.reshape(shape, order="F" if in_columns else "C").copy()


def parse_npz(data: bytes, names: Iterable[str], path: Path) -> dict[str, NDArray[Any]]:
    """Arrays of an uncompressed archive that :func:`numpy.savez` wrote.

    Raises:
        DatasetError: it is not such an archive, or an array is missing, compressed or damaged.
    """
    out = {}
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            for name in names:
                entry = archive.getinfo(f"{name}.npy")
                if entry.compress_type != zipfile.ZIP_STORED or entry.file_size != entry.compress_size:
                    raise DatasetError(f"'{name}' is compressed; expected an archive as it was written", path)
                out[name] = parse_npy(archive.read(entry), path)
    except DatasetError:
        raise
    # Archives that are encrypted, split, truncated or of another version raise more than BadZipFile.
    except Exception as bad:
        raise DatasetError(f"is not a complete archive of arrays ({type(bad).__name__})", path) from bad
    return out
