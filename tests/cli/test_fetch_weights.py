"""``relocbench fetch-weights``: what is shown, asked and kept, against a server of this process."""

from __future__ import annotations

import hashlib
import http.server
import io
import socket
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from command_line import relocbench

from relocbench.methods.fetching import Weights, weights_of
from relocbench.methods.specs import parse_method
from relocbench.weights import PublishedFile, SupportsFetching

CONTENT = b"numbers of a network" * 40_000
DIGEST = hashlib.sha256(CONTENT).hexdigest()


class _Server(http.server.BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        if self.path == "/absent":
            self.send_error(404)
            return
        if self.path == "/moved":
            self.send_response(302)
            self.send_header("Location", "/whole")
            self.end_headers()
            return
        if self.path == "/elsewhere":
            self.send_response(302)
            self.send_header("Location", "ftp://127.0.0.1/whole")
            self.end_headers()
            return
        self.send_response(200)
        self.send_header("Content-Length", str(0 if self.path == "/empty" else len(CONTENT)))
        self.end_headers()
        if self.path != "/empty":
            self.wfile.write(CONTENT[: len(CONTENT) // 2] if self.path == "/cut" else CONTENT)

    def log_message(self, format: str, *args: object) -> None:
        pass


class _QuietServer(http.server.ThreadingHTTPServer):
    def handle_error(self, request: object, client_address: object) -> None:
        """Say nothing of a client that hangs up: it would stand among what the command prints."""


@pytest.fixture(scope="module")
def server() -> Iterator[str]:
    with _QuietServer(("127.0.0.1", 0), _Server) as made:
        threading.Thread(target=made.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{made.server_port}"
        made.shutdown()


class Published:
    """A tracker whose weights are where a test says."""

    files: dict[Path, PublishedFile] = {}  # noqa: RUF012  set by each test

    def __init__(self, *, size: str = "small") -> None: ...

    def track(self, reference: object, query: object, prior: object = None) -> None: ...

    @classmethod
    def published(cls, size: str = "small", **_: object) -> dict[Path, PublishedFile]:
        return {path: file for path, file in cls.files.items() if size in path.name}


METHOD = "test_fetch_weights:Published"


def test_a_method_that_needs_no_published_file_needs_no_weights(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.path", [str(Path(__file__).parent), *sys.path])
    method = parse_method(METHOD)
    assert weights_of(method) is Weights.NONE
    monkeypatch.setattr(Published, "files", {Path("small"): PublishedFile("small", "http://absent", "them", "MIT")})
    assert weights_of(method) is Weights.MISSING


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where the weights belong; nothing answers at their address until a test says."""
    monkeypatch.setattr("sys.path", [str(Path(__file__).parent), *sys.path])
    monkeypatch.setitem(sys.modules, "test_fetch_weights", sys.modules[__name__])
    return tmp_path / "cache" / "small.pth"


def publish(place: Path, address: str, sha256: str | None = DIGEST, size_bytes: int | None = None) -> None:
    Published.files = {place: PublishedFile(place.name, address, "its authors", "MIT", sha256, size_bytes)}


def answering(monkeypatch: pytest.MonkeyPatch, words: str) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO(words))


def test_a_tracker_that_publishes_fits_the_contract() -> None:
    assert isinstance(Published, SupportsFetching)


def test_what_is_fetched_is_shown_and_asked_about(server: str, place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    publish(place, f"{server}/moved", DIGEST, len(CONTENT))
    answering(monkeypatch, "no\n")
    told = relocbench("fetch-weights", METHOD)
    assert told.status == 2
    assert "nothing was fetched" in told.complaint
    for word in (f"{server}/moved", "its authors", "MIT", DIGEST, str(place), "0.8 MB", "Fetch it? [y/N]"):
        assert word in told.out
    assert not place.parent.exists()
    answering(monkeypatch, "y\n")
    told = relocbench("fetch-weights", METHOD, "-q")
    assert (told.status, told.err) == (0, "")
    assert f"{place}: fetched; its SHA-256 is {DIGEST} (as expected)" in told.out
    assert place.read_bytes() == CONTENT
    assert list(place.parent.iterdir()) == [place]


def test_no_answer_is_no(server: str, place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    publish(place, f"{server}/whole")
    answering(monkeypatch, "")
    told = relocbench("fetch-weights", METHOD)
    assert told.status == 2
    assert "not confirmed" in told.complaint


def test_a_file_without_a_known_digest_is_fetched_only_when_asked_for(server: str, place: Path) -> None:
    publish(place, f"{server}/whole", None)
    told = relocbench("fetch-weights", METHOD, "--yes", "-q")
    assert told.status == 2
    assert place.name in told.complaint
    assert not place.parent.exists()
    told = relocbench("fetch-weights", METHOD, "--yes", "--unverified", "-q")
    assert told.status == 0
    assert "size unknown" in told.out
    assert DIGEST in told.out
    assert place.read_bytes() == CONTENT


def test_a_file_that_is_there_is_never_replaced(server: str, place: Path) -> None:
    place.parent.mkdir()
    place.write_bytes(b"mine")
    publish(place, f"{server}/whole", None)
    told = relocbench("fetch-weights", METHOD, "--yes")
    assert told.status == 0
    assert "is there already" in told.out
    publish(place, f"{server}/whole", "0" * 64)
    told = relocbench("fetch-weights", METHOD, "--yes")
    assert told.status == 2
    assert f"{place}: is not the published file" in told.complaint
    assert place.read_bytes() == b"mine"


def closed_port() -> int:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return int(taken.getsockname()[1])


@pytest.mark.parametrize(
    ("path", "sha256", "words"),
    [
        ("{server}/absent", DIGEST, "cannot be fetched: the server answers 404 Not Found"),
        ("{server}/cut", DIGEST, f"cut short, {len(CONTENT) // 2} of {len(CONTENT)} bytes came"),
        ("{server}/empty", DIGEST, "the answer is empty"),
        ("{server}/elsewhere", DIGEST, "cannot be fetched"),
        ("{server}/whole", "0" * 64, "not the published file: its SHA-256 is"),
        ("http://127.0.0.1:{closed}/whole", DIGEST, "cannot be fetched: [Errno 111] Connection refused"),
        ("file:///no/such/file", DIGEST, "cannot be fetched"),
        ("no address", DIGEST, "cannot be fetched: unknown url type"),
    ],
)
def test_a_failure_is_one_line_and_leaves_nothing(server: str, place: Path, path: str, sha256: str, words: str) -> None:
    publish(place, path.format(server=server, closed=closed_port()), sha256)
    told = relocbench("fetch-weights", METHOD, "--yes", "-q")
    assert told.status == 2
    assert words in told.complaint
    assert not place.exists()
    assert not place.parent.exists() or list(place.parent.iterdir()) == []


def test_a_server_that_says_nothing_is_given_up(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("relocbench.methods.fetching._TIMEOUT_S", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        publish(place, f"http://127.0.0.1:{silent.getsockname()[1]}/whole")
        told = relocbench("fetch-weights", METHOD, "--yes", "-q")
    assert told.status == 2
    assert "no answer within" in told.complaint


def test_a_folder_that_cannot_be_made_is_one_line(server: str, place: Path) -> None:
    place.parent.write_text("a file where the folder should be")
    publish(place, f"{server}/whole")
    told = relocbench("fetch-weights", METHOD, "--yes", "-q")
    assert told.status == 2
    assert str(place.parent) in told.complaint


def test_parameters_choose_the_file(server: str, place: Path) -> None:
    publish(place, f"{server}/whole")
    told = relocbench("fetch-weights", METHOD, "--set", "size=large")
    assert told.status == 2
    assert "needs no files that others publish" in told.complaint


def test_a_file_of_the_disk_is_fetched_as_well(place: Path, tmp_path: Path) -> None:
    source = tmp_path / "source.pth"
    source.write_bytes(CONTENT)
    publish(place, source.as_uri())
    assert relocbench("fetch-weights", METHOD, "--yes", "-q").status == 0
    assert place.read_bytes() == CONTENT


def test_methods_without_weights_of_others_say_so() -> None:
    told = relocbench("fetch-weights", "orb-pnp")
    assert told.status == 2
    assert "method 'orb-pnp' needs no files that others publish" in told.complaint
    assert "no method 'orb-pmp'" in relocbench("fetch-weights", "orb-pmp").complaint


@pytest.mark.parametrize(
    ("method", "model", "words"),
    [
        ("aliked-pnp", "t16", ("aliked-t16.pth (0.8 MB)", "BSD-3-Clause", "56782336919db220")),
        ("netvlad", "mapillary_WPCA128", ("mapillary_WPCA128.pth.tar (67.3 MB)", "MIT", "5b6de8a5537061bb")),
    ],
)
def test_weights_of_trackers_and_retrievers_are_shown_with_their_digest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, method: str, model: str, words: tuple[str, ...]
) -> None:
    pytest.importorskip("torch")
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    answering(monkeypatch, "")
    told = relocbench("fetch-weights", method, "--set", f"model={model}")
    assert told.status == 2
    for word in (*words, f"{tmp_path}/hub/checkpoints"):
        assert word in told.out
