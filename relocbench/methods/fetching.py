"""Fetching the files that a method needs and others publish, when a user asks for it; nothing else downloads."""

from __future__ import annotations

import hashlib
import http.client
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import IO, Any

from relocbench.errors import MethodError, one_line
from relocbench.files import atomic_write, sha256_file
from relocbench.methods.discovery import method_class
from relocbench.methods.lookup import call_third_party
from relocbench.methods.specs import MethodSpec
from relocbench.progress import Reporter, Silent
from relocbench.weights import PublishedFile

_TIMEOUT_S = 30.0
"""for a connection and for each part of an answer"""
_PART_BYTES = 2**18
_MOST_BYTES = 2**33
"""weights of features have at most tens of MB; a server that never ends is stopped"""


def published_files(method: MethodSpec) -> dict[Path, PublishedFile]:
    """The files that others publish and a method needs with its parameters, by where they belong.

    Raises:
        MethodError: it needs none.
    """
    files = _published(method)
    if not files:
        raise MethodError(f"method '{method.label}' needs no files that others publish")
    return files


def _published(method: MethodSpec) -> dict[Path, PublishedFile]:
    """The same, and nothing for a method that needs none. Raises MethodError where ``published()`` breaks."""
    tell = getattr(method_class(method.target, method.kind), "published", None)
    files: Any = {}
    if callable(tell):
        files = call_third_party(
            f"the published files of '{method.label}' cannot be listed", lambda: tell(**method.parameters)
        )
    if not isinstance(files, Mapping) or not all(isinstance(file, PublishedFile) for file in files.values()):
        raise MethodError(f"method '{method.label}': published() returned no files by their paths")
    return {Path(path): file for path, file in files.items()}


class Weights(StrEnum):
    """Where the weights of a method are."""

    NONE = "none needed"
    INCLUDED = "included"
    FETCHED = "fetched"
    MISSING = "to be fetched"
    TRAINED = "to be trained"
    """a parameter names the file of a training"""


def weights_of(method: MethodSpec) -> Weights:
    """Where the weights are that a method needs with its parameters. Raises MethodError."""
    factory = method_class(method.target, method.kind)
    if callable(getattr(factory, "published", None)):
        files = _published(method)
        if not files:
            return Weights.NONE
        return Weights.FETCHED if all(path.is_file() for path in files) else Weights.MISSING
    if "weights" not in method.parameters:
        return Weights.NONE
    return Weights.INCLUDED if method.files() else Weights.TRAINED


def check_fetched(path: Path, file: PublishedFile) -> None:
    """Check a file that is there already.

    Raises:
        MethodError: its SHA-256 is known and another one.
    """
    if file.sha256 is not None and (digest := sha256_file(path)) != file.sha256:
        raise MethodError(f"is not the published file: its SHA-256 is {digest}, expected {file.sha256}", path)


def fetch(file: PublishedFile, path: Path, reporter: Reporter | None = None) -> str:
    """Download a published file to a place where nothing is yet, whole or not at all. Returns its SHA-256.

    Raises:
        MethodError: it cannot be downloaded, is incomplete, is not the published one, or there is a file by now.
    """
    with _answer(file.address) as answer, atomic_write(path, "wb") as stream:
        digest = _copy(answer, stream, file, reporter or Silent())
        if path.exists() or path.is_symlink():
            raise MethodError("another program has written this file meanwhile; it is kept", path)
    return digest


def _answer(address: str) -> Any:
    """The open answer of a server. Raises MethodError."""
    with _faults_reported(address):
        request = urllib.request.Request(address, headers={"User-Agent": "relocbench"})
        answer = urllib.request.urlopen(request, timeout=_TIMEOUT_S)
    asked, answered = (urllib.parse.urlsplit(each).scheme for each in (address, answer.geturl()))
    if asked != answered:
        answer.close()
        raise MethodError(f"{address}: cannot be fetched: it is redirected from {asked} to {answered}")
    return answer


def _copy(answer: Any, stream: IO[bytes], file: PublishedFile, reporter: Reporter) -> str:
    """Copy an answer and return its SHA-256. Raises MethodError if it is incomplete or not the published file."""
    announced = answer.headers.get("Content-Length")
    total = int(announced) if announced is not None and announced.isdigit() else file.size_bytes
    digest, received = hashlib.sha256(), 0
    with reporter.stage(f"fetching {file.name}, bytes", total or 0) as advance:
        while part := _read(answer, file.address):
            received += len(part)
            if received > _MOST_BYTES:
                raise MethodError(f"{file.address}: longer than {_MOST_BYTES} bytes, which no weights are")
            digest.update(part)
            stream.write(part)
            advance(len(part))
    if announced is not None and announced.isdigit() and received != int(announced):
        raise MethodError(f"{file.address}: cut short, {received} of {announced} bytes came")
    if received == 0:
        raise MethodError(f"{file.address}: the answer is empty")
    found = digest.hexdigest()
    if file.sha256 is not None and found != file.sha256:
        raise MethodError(
            f"{file.address}: not the published file: its SHA-256 is {found}, expected {file.sha256}; nothing is kept"
        )
    return found


def _read(answer: Any, address: str) -> bytes:
    with _faults_reported(address):
        return bytes(answer.read(_PART_BYTES))


@contextmanager
def _faults_reported(address: str) -> Iterator[None]:
    """Raise what the network or the server raises as a MethodError."""
    try:
        yield
    except (OSError, http.client.HTTPException, ValueError) as bad:
        raise MethodError(f"{address}: cannot be fetched: {_reason(bad)}") from bad


def _reason(bad: Exception) -> str:
    if isinstance(bad, urllib.error.HTTPError):
        return f"the server answers {bad.code} {one_line(bad.reason)}"
    if isinstance(bad, TimeoutError) or isinstance(getattr(bad, "reason", None), TimeoutError):
        return f"no answer within {_TIMEOUT_S:.0f} s"
    return one_line(getattr(bad, "reason", bad)) or type(bad).__name__
