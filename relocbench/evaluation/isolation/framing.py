"""Messages between an evaluator and the process of a method, over a pair of connected sockets.

Questions are pickled, with their arrays beside the pickle so that they are copied once. Answers come from a process
that runs anybody's code: they are JSON and arrays of floats, and nothing in them is executed. Each names the question
that it answers by a number drawn for it, so that nothing can be answered before it is asked.
"""

from __future__ import annotations

import json
import math
import pickle
import socket
import struct
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

_COUNT = struct.Struct("<Q")
_LOOK_S = 0.25
_MOST_TEXT = 2**26
_MOST_ARRAYS = 4096
_ITEM_BYTES = (2, 4, 8)
_MOST_BYTES = 2**31


class FramingFault(Exception):
    """An answer that is not what the protocol says."""


def send_request(connection: socket.socket, question: str, request: Any) -> None:
    """Send any object that can be pickled, and what its answer must name. Raises OSError if the other side is gone."""
    buffers: list[pickle.PickleBuffer] = []
    text = pickle.dumps((question, request), protocol=5, buffer_callback=buffers.append)
    parts = [buffer.raw() for buffer in buffers]
    sizes = [len(text), *(part.nbytes for part in parts)]
    connection.sendall(b"".join(map(_COUNT.pack, [len(sizes), *sizes])) + text)
    for part in parts:
        connection.sendall(part)


def receive_request(connection: socket.socket) -> tuple[str, Any]:
    """The question's number, and the object that the evaluator sent; its arrays are read-only.

    Raises:
        EOFError: the evaluator is gone.
    """
    count = _number(connection)
    sizes = [_number(connection) for _ in range(count)]
    text, *parts = [_bytes(connection, size) for size in sizes]
    asked: tuple[str, Any] = pickle.loads(text, buffers=[memoryview(part).toreadonly() for part in parts])
    return asked


def send_answer(
    connection: socket.socket, question: str, words: Any, arrays: Sequence[NDArray[np.floating]] = ()
) -> None:
    """Send plain values and arrays of float16, float32 or float64."""
    about = [[array.dtype.itemsize, *array.shape] for array in arrays]
    text = json.dumps({"question": question, "words": words, "arrays": about}).encode()
    connection.sendall(_COUNT.pack(len(text)) + text)
    for array in arrays:
        connection.sendall(np.ascontiguousarray(array, dtype=f"<f{array.dtype.itemsize}").tobytes())


def receive_answer(
    connection: socket.socket, question: str, alive: Callable[[], bool]
) -> tuple[Any, list[NDArray[np.floating]]]:
    """Plain values and arrays of floats.

    Args:
        question: what the answer must name.
        alive: whether the other side still runs. The end of the connection is not enough to tell: processes that the
            other side has started may hold it open.

    Raises:
        EOFError: the other side is gone.
        FramingFault: what came is no answer.
    """
    length = _number(connection, alive)
    if length > _MOST_TEXT:
        raise FramingFault(f"an answer of {length} bytes, at most {_MOST_TEXT} are read")
    text = _bytes(connection, length, alive)
    try:
        answer = json.loads(bytes(text).decode())
        words, about = answer["words"], [tuple(map(_size, numbers)) for numbers in answer["arrays"]]
    except (ValueError, KeyError, TypeError, RecursionError):
        raise FramingFault("something that is not a JSON object of words and arrays") from None
    if answer.get("question") != question:
        raise FramingFault("an answer to another question")
    sizes = [math.prod(numbers) for numbers in about]
    if len(about) > _MOST_ARRAYS or sum(sizes) > _MOST_BYTES:
        raise FramingFault(f"{len(about)} arrays of {sum(sizes)} bytes together")
    if any(not numbers or numbers[0] not in _ITEM_BYTES for numbers in about):
        raise FramingFault("arrays whose numbers are not floats")
    arrays: list[NDArray[np.floating]] = [
        np.frombuffer(_bytes(connection, size, alive), dtype=f"<f{numbers[0]}").reshape(numbers[1:])
        for size, numbers in zip(sizes, about, strict=True)
    ]
    return words, arrays


def _size(value: Any) -> int:
    if type(value) is not int or value < 0:
        raise ValueError("a size that is not a count")
    return value


def _always() -> bool:
    return True


def _number(connection: socket.socket, alive: Callable[[], bool] = _always) -> int:
    return int(_COUNT.unpack(_bytes(connection, _COUNT.size, alive))[0])


def _bytes(connection: socket.socket, size: int, alive: Callable[[], bool] = _always) -> bytearray:
    data = bytearray(size)
    view = memoryview(data)
    connection.settimeout(None if alive is _always else _LOOK_S)
    try:
        while view:
            was_alive = alive()
            try:
                got = connection.recv_into(view)
            except TimeoutError:
                if was_alive:
                    continue
                raise EOFError from None
            if not got:
                raise EOFError
            view = view[got:]
    finally:
        connection.settimeout(None)
    return data
