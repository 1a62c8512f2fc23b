"""The wording of errors is compared in one place, so that a better sentence is one changed line."""

from __future__ import annotations

import messages as tool
import pytest


@pytest.mark.thorough
def test_the_catalogue_holds_the_messages_of_the_code() -> None:
    kept, now = set(tool.CATALOGUE.read_text(encoding="utf-8").splitlines()), set(tool.catalogue())
    changes = [f"- {line}" for line in sorted(kept - now)] + [f"+ {line}" for line in sorted(now - kept)]
    assert not changes, "\n".join(["messages changed; look at them and run: python tools/messages.py", *changes])
