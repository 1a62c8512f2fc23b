"""Texts of a format's own words, drawn by hypothesis."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import seed as seeded
from hypothesis import strategies as st
from hypothesis.internal.conjecture.choice import choice_permitted
from hypothesis.internal.conjecture.providers import AVAILABLE_PROVIDERS, GLOBAL_CONSTANTS, HypothesisProvider

BATCH = 25
"""texts that are drawn together"""
_MOST_WORDS = 300
_AWKWARD = (
    "", "-1", "0", "1e400", "nan", "inf", "-0.0", "²²", "../../x", "\0", "9" * 5000, "x" * 3000, "'", '"', "!!int x",
    "*a", "&a", "2001-99-99", "0b_", "[", "{", "]", "}", "- ", ": ", "true", "null", "\x1b[31m", "\u2028", "#",
    "=1+1",
)  # fmt: skip


class WithoutTheCode(HypothesisProvider):
    """Draws as hypothesis does, but for the constants of the modules that happen to be loaded: it would mix them in,
    and the same seed would give other texts in another process."""

    def _maybe_draw_constant(self, choice_type: Any, constraints: Any, *, p: float = 0.05) -> Any:
        assert self._random is not None
        if self._random.random() > p:
            return None
        known = [c for c in GLOBAL_CONSTANTS.set_for_type(choice_type) if choice_permitted(c, constraints)]
        return self._random.choice(known) if known else None


AVAILABLE_PROVIDERS["without-the-code"] = f"{__name__}.{WithoutTheCode.__name__}"


def texts_of(text: str, seed: int, batch: int) -> Sequence[str]:
    """A batch of texts made of the words and lines of a valid one; the same for the same arguments."""
    return _texts(text, seed * 1_000_003 + batch)


@lru_cache(maxsize=8)
def _texts(text: str, seed: int) -> tuple[str, ...]:
    found: list[str] = []

    @settings(
        backend="without-the-code",
        max_examples=BATCH,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @seeded(seed)
    @given(documents(text))
    def collect(drawn: str) -> None:
        found.append(drawn)

    collect()
    return tuple(found[:BATCH])


def documents(text: str) -> st.SearchStrategy[str]:
    """Lines of a valid text in any order, between lines of its words and of awkward ones."""
    lines = sorted(set(text.splitlines()[:_MOST_WORDS])) or [""]
    words = sorted(set(re.split(r"[\s,]+", text)))[:_MOST_WORDS]
    one = st.one_of(
        st.sampled_from(words),
        st.sampled_from(words),
        st.sampled_from(_AWKWARD),
        st.integers().map(str),
        st.floats().map(repr),
        st.text(max_size=8),
    )
    between = st.sampled_from([",", ", ", " ", "  ", "\t", ": ", ";", ""])
    line = st.builds(lambda parts, gap: gap.join(parts), st.lists(one, max_size=14), between)
    indented = st.builds(lambda depth, inner: "  " * depth + inner, st.integers(0, 4), line)
    body = st.lists(st.one_of(st.sampled_from(lines), line, indented, _nested(one)), max_size=16)
    start = st.sampled_from(["", lines[0], text.splitlines()[0] if text else "", "\ufeff"])
    end = st.sampled_from(["\n", "\r\n", "\r", ""])
    return st.builds(lambda first, rest, gap: gap.join([first, *rest]) + gap, start, body, end)


def _nested(one: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    """Lists and mappings as YAML and JSON write them on a line."""
    key = one.map(lambda text: text[:40])
    deep = st.recursive(
        key,
        lambda inner: st.one_of(
            st.lists(inner, max_size=4).map(lambda parts: f"[{', '.join(parts)}]"),
            st.dictionaries(key, inner, max_size=3).map(
                lambda pairs: "{" + ", ".join(f"{k}: {v}" for k, v in pairs.items()) + "}"
            ),
        ),
        max_leaves=8,
    )
    return st.builds(lambda name, value: f"{name}: {value}", key, deep)
