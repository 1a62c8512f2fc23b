"""Build hook: the README as a package index shows it, where links and pictures need whole addresses.

In the repository the README's links are relative. When a package is built they get the address of the repository that
``[project.urls]`` names as ``Source``, at the tag of the version; without one they stay as they are.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

_LINK = re.compile(r"(!?)\[([^\]]*)\]\((?!#|[a-z]+:)([^)\s]+)\)")


class AbsoluteReadme(MetadataHookInterface):
    """Gives a package the README with whole addresses."""

    def update(self, metadata: dict[str, Any]) -> None:
        text = (Path(self.root) / "README.md").read_text(encoding="utf-8")
        source = metadata.get("urls", {}).get("Source")
        if source is not None:
            text = with_whole_addresses(text, source, f"v{metadata['version']}")
        metadata["readme"] = {"content-type": "text/markdown", "text": text}


def with_whole_addresses(text: str, source: str, revision: str) -> str:
    """The text with its relative links led to a repository's files, and its pictures to their contents."""

    def whole(link: re.Match[str]) -> str:
        picture, label, path = link.groups()
        return f"{picture}[{label}]({source}/{'raw' if picture else 'blob'}/{revision}/{path})"

    return _LINK.sub(whole, text)
