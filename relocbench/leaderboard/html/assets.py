"""The scripts and styles of the site: our own, and those that the packages plotly and itables ship."""

from __future__ import annotations

import re
from importlib.resources import files
from pathlib import Path

from relocbench.errors import ConfigError
from relocbench.files import write_bytes, write_text

_OWN = (
    *("site.css", "core.js", "tables.js", "charts.js", "legend.js", "heat.js", "start.js"),
    *("rows.js", "parts.js", "errors.js", "recall.js", "stages.js", "map.js", "against.js", "measured.js", "board.js"),
    *("walk.js", "warp.js", "matches.js", "pair.js", "pair.css", "query.js", "places.css"),
)
_EXPORT = re.compile(r"export\{[^{}]*?(\w+) as default[^{}]*\};?")
_NOTICES = """\
The pages of this site use these programs, which are in the folder assets:

plotly.min.js     Plotly.js, copyright Plotly, Inc., MIT licence
datatables.js     DataTables and its extensions, copyright SpryMedia Ltd, MIT licence; jQuery, copyright OpenJS
                  Foundation and other contributors, MIT licence; further licences stand at the beginning of the file
datatables.css    DataTables, copyright SpryMedia Ltd, MIT licence

The bundle of DataTables is that of the package itables, MIT licence, with its export replaced by a name of the window:
pages that are opened from a disk cannot load modules. All other scripts and styles are those of relocbench, licence
Apache-2.0.
"""


def asset_files(site: Path) -> set[Path]:
    """The files of :func:`write_assets`."""
    shipped = ("plotly.min.js", "datatables.js", "datatables.css")
    return {site / "notices.txt", *(site / "assets" / name for name in (*_OWN, *shipped))}


def write_assets(site: Path) -> None:
    """Write ``assets/`` and ``notices.txt`` below the folder of the site.

    Raises:
        ConfigError: the installed package itables has no bundle of DataTables that can be used.
    """
    own = files("relocbench.leaderboard.html") / "assets"
    for name in _OWN:
        write_bytes(site / "assets" / name, (own / name).read_bytes())
    write_bytes(site / "assets" / "plotly.min.js", (files("plotly") / "package_data" / "plotly.min.js").read_bytes())
    bundle = files("itables") / "html"
    write_text(site / "assets" / "datatables.js", _as_script((bundle / "dt_bundle.js").read_text(encoding="utf-8")))
    write_bytes(site / "assets" / "datatables.css", (bundle / "dt_bundle.css").read_bytes())
    write_text(site / "notices.txt", _NOTICES)


def _as_script(module: str) -> str:
    """A module with a default export as a script that puts it into ``window.DataTable``."""
    changed, count = _EXPORT.subn(lambda found: f"window.DataTable={found[1]};", module)
    if count != 1:
        raise ConfigError("the installed itables ships no DataTables that can be used; expected itables 2.4 to 2.9")
    return f"(()=>{{'use strict';\n{changed}\n}})();\n"
