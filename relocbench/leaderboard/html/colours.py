"""The one scale of colours of all maps, heat maps and cells: from bad, orange, over the middle to good, blue.

It is the same on white and on dark pages, told apart by all kinds of colour blindness, and the scripts have it too, as
``relocbench.QUALITY``.
"""

from __future__ import annotations

BAD, MIDDLE, GOOD = (179, 86, 27), (244, 244, 244), (43, 95, 184)
"""red, green and blue, 0 to 255"""


def share_style(share: float) -> str:
    """The background and the colour of the text of a cell with that share, 0 to 1, as a style attribute.

    Of black and white one always has a contrast of 4.5:1 at least.
    """
    low, high, part = (BAD, MIDDLE, 2 * share) if share < 0.5 else (MIDDLE, GOOD, 2 * share - 1)
    red, green, blue = (round(a + (b - a) * part) for a, b in zip(low, high, strict=True))
    luminance = 0.2126 * _linear(red) + 0.7152 * _linear(green) + 0.0722 * _linear(blue)
    ink = "#000" if (luminance + 0.05) / 0.05 >= 1.05 / (luminance + 0.05) else "#fff"
    return f"background:#{red:02x}{green:02x}{blue:02x};color:{ink}"


def _linear(channel: int) -> float:
    value = channel / 255
    return value / 12.92 if value <= 0.04045 else float(((value + 0.055) / 1.055) ** 2.4)
