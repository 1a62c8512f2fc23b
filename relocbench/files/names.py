"""Names that become parts of paths: one rule for all of them, wherever they come from."""

from __future__ import annotations

import hashlib
import re
import unicodedata
from collections.abc import Iterable

from relocbench.errors import quoted

MAX_NAME_BYTES = 100
"""UTF-8 bytes of one name; three of them and an ending make the name of a file, which has 255"""
MAX_JOINED_BYTES = 200
"""of a name that is joined from others, as a pair set's or a dataset's"""
MAX_FOLDER_BYTES = 240
"""of what stands before ``@FINGERPRINT`` in the name of a folder of results"""
_DEVICE = re.compile(r"(con|prn|aux|nul|com[0-9¹²³]|lpt[0-9¹²³])(\..*)?", re.IGNORECASE)
"""what Windows takes for a device, with any ending"""
_FILE = re.compile(r".*\.(ya?ml|csv|txt|jsonl?|md|png|parquet|part|errors|matching|journal)", re.IGNORECASE)
"""a name of the project's own files, or one that would be once their endings are put behind it"""


def check_name(name: str, what: str, most_bytes: int = MAX_NAME_BYTES) -> str:
    """A name that can be part of a file name and of ``REF__QUERY__CAM``, on any system.

    Letters, the digits 0 to 9 and ``. _ + -``, without ``__``; it begins with a letter, a digit or ``+``, ends with
    neither ``_`` nor ``.``, is no device of Windows and not called as the project's own files are.

    Args:
        what: is named, for the message.

    Raises:
        ValueError: with one line of what is wrong.
    """
    allowed = name and all(c.isalpha() or c in "0123456789._+-" for c in name)
    if allowed and unicodedata.normalize("NFKC", name) != name:
        raise ValueError(f"{what} {quoted(name)} has letters that only look like others, such as raised or wide ones")
    if not allowed or name.startswith((".", "-", "_")) or name.endswith("_") or "__" in name:
        raise ValueError(
            f"{what} {quoted(name)} must be letters, digits and . _ + - only, without '__', not starting with . - or _"
        )
    if name.endswith("."):
        raise ValueError(f"{what} {quoted(name)} must not end with a full stop")
    if len(name.encode()) > most_bytes:
        raise ValueError(f"{what} {quoted(name)} has {len(name.encode())} bytes, expected at most {most_bytes}")
    if _DEVICE.fullmatch(name):
        raise ValueError(f"{what} {quoted(name)} is the name of a device; choose another")
    if _FILE.fullmatch(name):
        raise ValueError(f"{what} {quoted(name)} is called like one of the files that are written here; choose another")
    return name


def check_label(name: str, what: str) -> str:
    """The label of a method: a name as :func:`check_name` wants it, of ASCII letters alone.

    Labels stand in tables beside marks and beside each other, where ``dso`` must differ visibly from similar labels.

    Raises:
        ValueError: with one line of what is wrong.
    """
    check_name(name, what)
    if not name.isascii():
        raise ValueError(f"{what} {quoted(name)} must be letters a to z and A to Z, digits and . _ + - only")
    return name


def check_joined_name(name: str, what: str, most_bytes: int = MAX_JOINED_BYTES) -> str:
    """Names joined by ``__``, each as :func:`check_name` wants it, as the pair set ``REF__QUERY__CAM``.

    Raises:
        ValueError: with one line of what is wrong.
    """
    if len(name.encode(errors="replace")) > most_bytes:
        raise ValueError(f"{what} {quoted(name)} has more than {most_bytes} bytes")
    names = name.split("__")
    for part in names:
        # A dataset's name may be joined of several by other means, and be as long.
        check_name(part, f"{what} {quoted(name)}: its part" if len(names) > 1 else what, most_bytes)
    return name


def plain_name(text: str, what: str) -> str:
    """A name after a folder's: what a name cannot hold becomes ``-``. Raises ValueError where nothing is left."""
    plain = re.sub(r"_{2,}", "_", re.sub(r"[^0-9A-Za-z._+-]", "-", text))
    return check_name(plain.lstrip("._-").rstrip("_."), what)


def check_distinct(names: Iterable[str], what: str) -> None:
    """Raises ValueError where two names are one to a file system that does not tell capital letters from small ones."""
    seen: dict[str, str] = {}
    for name in names:
        folded = unicodedata.normalize("NFC", name).casefold()
        if folded in seen:
            raise ValueError(f"two {what} differ in capital letters only: {quoted(seen[folded])} and {quoted(name)}")
        seen[folded] = name


def natural(name: str) -> tuple[list[int | str], str]:
    """A key that puts 2 before 10."""
    parts = re.split("([0-9]+)", name)  # numbers stand at odd places
    return [int(part) if place % 2 else part for place, part in enumerate(parts)], name


def fitting_name(name: str, most_bytes: int = MAX_JOINED_BYTES) -> str:
    """The name, or where it is longer than a name may be, its beginning and a hash of all of it."""
    if len(name.encode()) <= most_bytes:
        return name
    digest = hashlib.sha256(name.encode()).hexdigest()[:12]
    kept = name.encode()[: most_bytes - len(digest) - 1].decode(errors="ignore")
    return f"{kept.rstrip('._-')}-{digest}"
