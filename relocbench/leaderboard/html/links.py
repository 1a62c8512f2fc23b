"""Names of files and links of the site: what people may have bookmarked or cited, and so what stays as it is.

Everything is relative to the folder of the site; every file lies directly in it or in ``data/`` and ``assets/``. The
state of a page stands in the part of its address behind ``#``, as ``key=value&key=value`` with percent-encoded values:

- a pair: ``pair.html#set=ID&pairset=PAIRSET&pair=REF-QUERY&method=LABEL``, with the timestamps of keyframe and query in
  nanoseconds, and ``&within=METRES,DEGREES`` where a found pair must be closer than usual
- a query of retrievers: ``query.html#set=ID&task=TASK&query=KEY&method=LABEL``
- a query of pipelines: ``located.html#set=ID&task=TASK&query=TIMESTAMP&pipeline=LABEL``

``ID`` is what :func:`set_id` gives; pair sets, tasks and methods have their own names.
"""

from __future__ import annotations

import hashlib
import re
from urllib.parse import quote

from relocbench.datasets.core.fingerprint import SHORT
from relocbench.evaluation.common.folders import SetLike
from relocbench.files import fitting_name, plain_name

START = "index.html"
PAIR_PAGE = "pair.html"
QUERY_PAGE = "query.html"
"""of one query and the images that were retrieved for it"""
LOCATED_PAGE = "located.html"
"""of one query, the keyframe that was retrieved for it and the tracker's answer"""
_LONGEST = 120
"""bytes of what a name contributes to the name of a file"""
_PLAIN = re.compile(r"[0-9A-Za-z][0-9A-Za-z._+-]*")


def set_id(record: SetLike) -> str:
    """The id of a set, which is part of file names and of addresses: its name and short fingerprint."""
    return f"{file_id(record.name)}-{file_id(record.fingerprint[:SHORT])}"


def set_page(record: SetLike, task: str = "set") -> str:
    """The page of a set; ``task`` is ``set`` for trackers, ``retrieval`` or ``relocalization``."""
    return f"{task}-{set_id(record)}.html"


def unit_key(folder: str, record: SetLike, unit: str) -> str:
    """The key of a payload of a pair set or task of a set."""
    return f"{folder}/{set_id(record)}/{file_id(unit)}"


def method_page(label: str) -> str:
    """The page of a method, which may be a tracker, a retriever or both."""
    return f"method-{file_id(label)}.html"


def hash_of(state: dict[str, str]) -> str:
    """The state of a page as it stands in its address, without the ``#``."""
    return "&".join(f"{key}={quote(value, safe='')}" for key, value in state.items())


def data_file(key: str) -> str:
    """The file of a payload, by the key that it registers itself with; see :mod:`relocbench.leaderboard.html.data`."""
    return f"data/{key}.js"


def file_id(name: str) -> str:
    """A name as a part of names of files: itself where it is one of plain ASCII in lower case.

    Otherwise what is left of it, with a hash of all of it.
    Names that differ in case alone would be one file on some systems.
    """
    short = fitting_name(name, _LONGEST)
    if _PLAIN.fullmatch(short) and short == short.lower():
        return short
    digest = hashlib.sha256(name.encode(errors="surrogatepass")).hexdigest()[:SHORT]
    try:
        return f"{plain_name(short[:40], 'the name')}-{digest}"
    except ValueError:
        return f"named-{digest}"
