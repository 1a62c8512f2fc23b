"""A Dask scheduler: its address, the security of the connection, and what its workers must share with this process."""

from __future__ import annotations

import gc
import json
import logging
import ssl
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Self

from relocbench.errors import ConfigError, RelocbenchError
from relocbench.files import plain_file

SCHEDULER_TIMEOUT = "10s"
"""how long a Dask scheduler may take to answer"""
_CLOSING_S = 5
_TLS = "tls://"


@dataclass(frozen=True)
class Scheduler:
    """The address of a Dask scheduler with its certificates."""

    __pydantic_config__: ClassVar = {"extra": "forbid"}

    address: str
    """``tcp://host:port``, ``tls://host:port``, or the path of the JSON file that ``dask scheduler`` writes"""
    tls_ca: Path | None = None
    """PEM file with the certificate of the authority that signed the scheduler's and the workers' certificates"""
    tls_cert: Path | None = None
    """PEM file with the certificate of this client"""
    tls_key: Path | None = None
    """PEM file with the private key of ``tls_cert``, unless that file holds it"""
    writes: Path | None = None
    """folder that is written to, and that every worker must see"""
    reads: tuple[Path, ...] = ()
    """files and folders that every worker must see"""

    def with_shared_folders(self, writes: Path, *reads: Path | None) -> Self:
        """The same scheduler for work that writes to one folder and reads others."""
        found = tuple(path.absolute() for path in reads if path is not None)
        return replace(self, writes=writes.absolute(), reads=found)

    def __str__(self) -> str:
        return self.address


@contextmanager
def connected(scheduler: Scheduler) -> Iterator[Any]:
    """Connect a ``distributed.Client``, closed at the end. Dask's log is off meanwhile: errors say what it would.

    Raises:
        ConfigError: Dask is not installed, a file is missing or wrong, nothing answers.
    """
    try:
        from distributed import Client
        from distributed.versions import VersionMismatchWarning
    except ImportError:
        raise ConfigError("--scheduler needs the optional extra: pip install 'relocbench[cluster]'") from None
    address = _address(scheduler)
    security = _security(scheduler, address)
    with _quiet():
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", VersionMismatchWarning)  # versions are compared afterwards
                client = Client(address, timeout=SCHEDULER_TIMEOUT, security=security, set_as_default=False)
        except (OSError, ValueError, ImportError) as bad:
            reason = " ".join(str(bad).split())[:200] or type(bad).__name__
            raise ConfigError(f"no Dask scheduler answers at {scheduler} ({reason})") from None
        try:
            yield client
        finally:
            with suppress(OSError):
                client.close(timeout=_CLOSING_S)


def _address(scheduler: Scheduler) -> str:
    """The address itself, read from the scheduler's file if that was given."""
    path = Path(scheduler.address)
    if "://" in scheduler.address or not (path.suffix == ".json" or path.is_file()):
        return scheduler.address
    expected = "expected the JSON file that `dask scheduler --scheduler-file` writes"
    try:
        address = json.loads(plain_file(path, "a scheduler's file", ConfigError).read_text(encoding="utf-8"))["address"]
    except FileNotFoundError:
        raise ConfigError(f"missing; {expected}", path) from None
    except OSError as bad:
        raise ConfigError(f"cannot be read ({bad.strerror}); {expected}", path) from None
    except (ValueError, KeyError, TypeError, RecursionError):
        raise ConfigError(f"holds no address; {expected}", path) from None
    if not isinstance(address, str):
        raise ConfigError(f"holds an address that is not a string; {expected}", path)
    return address


def _security(scheduler: Scheduler, address: str) -> Any:
    """``distributed.Security`` for a ``tls://`` address; Dask's own configuration provides what is not given."""
    files = {"tls_ca": scheduler.tls_ca, "tls_cert": scheduler.tls_cert, "tls_key": scheduler.tls_key}
    if not address.startswith(_TLS):
        if any(files.values()):
            raise ConfigError(f"certificates are for a {_TLS} address, got {address}")
        return None
    from distributed.security import Security

    for name, path in files.items():
        if path is not None and not path.is_file():
            what = "is no file" if path.exists() else "missing"
            raise ConfigError(f"{what}; expected a PEM file for --scheduler-{name.replace('_', '-')}", path)
    names = {"tls_ca": "tls_ca_file", "tls_cert": "tls_client_cert", "tls_key": "tls_client_key"}
    given = {names[name]: str(path) for name, path in files.items() if path is not None}
    try:
        security = Security(require_encryption=True, **given)
        context = security.get_connection_args("client").get("ssl_context")
    except (ssl.SSLError, OSError, ValueError) as bad:
        raise ConfigError(f"these certificates cannot be used for TLS ({bad}): {', '.join(given.values())}") from None
    if context is None:
        raise ConfigError(
            f"{address} needs --scheduler-tls-ca, --scheduler-tls-cert and --scheduler-tls-key, or the same in Dask's "
            "own configuration"
        )
    return security


@contextmanager
def _quiet() -> Iterator[None]:
    """Turn off Dask's log, which would print tracebacks of faults that are reported in one line here."""
    names = [n for n in logging.root.manager.loggerDict if n.split(".")[0] in ("distributed", "tornado", "asyncio")]
    loggers = [logger for logger in map(logging.getLogger, names) if not logger.disabled]
    for logger in loggers:
        logger.disabled = True
    try:
        yield
    finally:
        gc.collect()  # tasks that the end of a connection broke log complaints when they are collected
        for logger in loggers:
            logger.disabled = False


def scheduler_is_gone(scheduler: Scheduler, progress: str) -> RelocbenchError:
    """The error of a run whose scheduler no longer answers."""
    return RelocbenchError(f"the Dask scheduler at {scheduler} is gone; {progress}")
