"""Ways to damage a file. All of them follow from the generator that is handed in, and from nothing else."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Sequence
from random import Random

LONG = 200_000
CANARY = b"@CANARY@"
"""is replaced by the path of a folder that nobody may write to"""

_WORDS: tuple[bytes, ...] = (
    b"\0", "²²".encode(), "٣".encode(), b"../../x", b"../../../../escaped", CANARY + b"/absolute", b"~", b"/", b".",
    b"1e400", b"-1e400", b"1e308", b"1e-320", b"NaN", b"nan", b"inf", b"-inf", b"Infinity", b"-0", b"-0.0", b"-1",
    b"0", b"0x10", b"0b_", b"0o8", b"1_0", b"1__0", b"+1", b"1.", b".5", b"2147483648", b"4294967296",
    b"9223372036854775807", b"9223372036854775808", b"18446744073709551616", b"9" * 400, b"9" * 5000,
    b"-" + b"9" * 5000, b"0." + b"3" * 5000, b"1e999999999999", b"1E+99999999999999999999", b"2001-99-99",
    b"2001-01-01", b"12:30:45", b"1:61", b"true", b"null", b"~", b"yes", b"!!int x", b"!!float y", b"!!binary =",
    b"!!timestamp 2001-99-99", b"!!python/object:os.system {}", b"!!python/object/apply:os.system ['x']",
    b"!!set {a, b}", b"!!omap [a: 1]", b"!unknown {}", b"*a", b"&a [*a]", b"<<: *a", b"? a", b"---\n", b"...\n",
    b"%YAML 9.9\n", b"[" * 5000, b"{" * 3000, b"[" * 400 + b"]" * 400, b"- " * 2000,
    b"{a: " * 500 + b"1" + b"}" * 500, b"(" * 1000, b'"', b'""', b'"a', b"'", b"`", b"|", b"\\", b"\\u0000",
    b"\\ud800", b"=1+1", b"@SUM(A1)", b"#", b"%s%n", b"{}", b"{0}", b",", b",,,,,,,,", b";", b"\t", b" ", b"\n",
    b"\r", b"\r\n", b"\x0b", b"\x0c", b"\x1c", b"\x85", "\u2028".encode(), "\u2029".encode(), "\xa0".encode(),
    "\u200b".encode(), "\u202e".encode(), "\ufeff".encode(), "\U0001f600".encode(), b"\xff", b"\xfe\xff", b"\xc3",
    b"\xed\xa0\x80", b"\x1b[31m", b"\x1b]0;x\x07", b"\x07", b"\x7f", b"\x08" * 20, b"A" * 300, b"A" * LONG,
    b"1 " * 20_000, b"1," * 20_000, b"\n" * 20_000, b"__", b"a__b__c", b"con", b"-o",
)  # fmt: skip
_BOMB = b"a: &a [x,x,x,x,x,x,x,x,x]\n" + b"".join(
    b"%c: &%c [*%c,*%c,*%c,*%c,*%c,*%c,*%c,*%c,*%c]\n" % (c, c, *([c - 1] * 9)) for c in range(ord("b"), ord("k"))
)
_WHOLE: tuple[bytes, ...] = (
    b"", b"\n", b"\0" * 4096, b"\xff" * 4096, b"{}", b"[]", b"null", b'"', b"a: b: c", b"- 1\n- 2\n", b"x" * LONG,
    b"0", _BOMB, b"[" * 100_000, b"&a [*a]", b"a: &a {b: *a}", b"PK\x03\x04" + b"\0" * 60,
    b"\x1f\x8b\x08\0" + b"\xff" * 60, b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff\xe0", b"\x93NUMPY\x01\0", b"PAR1PAR1",
    b"ply\nend_header\n", b"BM" + b"\xff" * 60, b"GIF89a" + b"\xff" * 20, b"II*\0" + b"\xff" * 60,
    b"\x80\x02cos\nsystem\n", b"P5\n99999 99999\n255\n", b"v/1\x01" + b"\xff" * 60,
)  # fmt: skip
_NUMBERS = (-1, 0, 1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 0x10000, 0x7FFFFFFF, 0xFFFFFFFF, 2**40, 2**62, 2**63 - 1, 2**64 - 1)
_HEADER_BYTES = 400
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?")
_WORD = re.compile(rb"[^\s,:;\[\]{}()\"']+")

Mutation = Callable[[Random, bytes], bytes]


def mutated(rng: Random, data: bytes, others: Sequence[bytes]) -> bytes:
    """One to three damages of a file's bytes.

    Args:
        others: the content of files of other formats, one of which may stand in its place.
    """
    if rng.random() < 0.08:
        return rng.choice([*_WHOLE, *others])
    damaged = data
    while damaged == data:  # some ways leave some files as they are
        for _ in range(rng.choice((1, 1, 1, 2, 3))):
            damaged = rng.choice(_MUTATIONS)(rng, damaged)
    return damaged


def word(rng: Random) -> bytes:
    """A value that readers stumble over."""
    return rng.choice(_WORDS)


def _flip(rng: Random, data: bytes) -> bytes:
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 8, 32))):
        if out:
            out[rng.randrange(len(out))] ^= 1 << rng.randrange(8)
    return bytes(out)


def _set_bytes(rng: Random, data: bytes) -> bytes:
    out = bytearray(data)
    if out:
        at, count = rng.randrange(len(out)), rng.choice((1, 2, 4, 16))
        out[at : at + count] = bytes(rng.choice((0, 0xFF, 0x80, 0x7F, rng.randrange(256))) for _ in range(count))
    return bytes(out)


def _insert(rng: Random, data: bytes) -> bytes:
    at = rng.randrange(len(data) + 1)
    return data[:at] + word(rng) + data[at:]


def _replace(pattern: re.Pattern[bytes]) -> Mutation:
    def replace(rng: Random, data: bytes) -> bytes:
        found = list(pattern.finditer(data[:LONG]))
        if not found:
            return _insert(rng, data)
        chosen = rng.choice(found)
        return data[: chosen.start()] + word(rng) + data[chosen.end() :]

    return replace


def _near_number(rng: Random, data: bytes) -> bytes:
    """A number by one that is a little or very different."""
    found = list(_NUMBER.finditer(data[:LONG]))
    if not found:
        return _flip(rng, data)
    chosen = rng.choice(found)
    old = chosen.group()
    new = rng.choice(
        (
            b"-" + old,
            old + b"0",
            old + b"0" * 9,
            old[:-1],
            old + b"e5",
            b"0" + old,
            old + b".5",
            b"%d" % rng.choice(_NUMBERS),
        )
    )
    return data[: chosen.start()] + new + data[chosen.end() :]


def _integer(rng: Random, data: bytes) -> bytes:
    """An integer of a binary header by another."""
    width, code = rng.choice(((1, "B"), (2, "H"), (4, "I"), (8, "Q")))
    reach = min(len(data), _HEADER_BYTES)
    near_end = rng.random() < 0.2
    at = rng.randrange(reach) if reach else 0
    at = max(len(data) - 1 - at, 0) if near_end else at
    value = rng.choice(_NUMBERS) % 256**width
    return data[:at] + struct.pack(rng.choice("<>") + code, value) + data[at + width :]


def _truncate(rng: Random, data: bytes) -> bytes:
    return data[: rng.randrange(len(data) + 1)]


def _cut_records(rng: Random, data: bytes) -> bytes:
    """Without some whole records at the end, of a length that points have."""
    return data[: max(len(data) - rng.choice((12, 16, 20, 24, 26, 28, 30, 34)) * rng.randrange(1, 9), 0)]


def _cut_out(rng: Random, data: bytes) -> bytes:
    a, b = sorted((rng.randrange(len(data) + 1), rng.randrange(len(data) + 1)))
    return data[:a] + data[min(b, a + rng.choice((1, 4, 64, b - a))) :]


def _repeat(rng: Random, data: bytes) -> bytes:
    a, b = sorted((rng.randrange(len(data) + 1), rng.randrange(len(data) + 1)))
    times = rng.choice((1, 1, 2, 50))
    return data[:b] + data[a:b] * min(times, LONG // (b - a + 1) + 1) + data[b:]


_HEADERS = (
    b"#t,x,y,z,qw,qx,qy,qz",
    b"timestamp y x z qx qy qz qw",
    b"#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []",
)


def _lines(rng: Random, data: bytes) -> bytes:
    """Lines swapped, left out, emptied, written twice or very often, put in another order; or a table in other units:
    decimal commas, a header, a row of NaN."""
    lines = data.split(b"\n")
    a, b = rng.randrange(len(lines)), rng.randrange(len(lines))
    kind = rng.randrange(10)
    if kind == 0:
        lines[a], lines[b] = lines[b], lines[a]
    elif kind == 1:
        del lines[a]
    elif kind == 2:
        lines.insert(b, lines[a])
    elif kind == 3:
        lines[a : a + 1] = [lines[a]] * min(2000, LONG // (len(lines[a]) + 1) + 1)
    elif kind == 4:
        rng.shuffle(lines)
    elif kind == 5:
        lines[a] = b""
    elif kind == 6:
        lines[a] = b" ".join([*lines[a].split()[:1], *[b"NaN"] * len(lines[a].split()[1:])])
    elif kind == 7:
        lines[a] = lines[a].replace(b",", b";").replace(b".", b",")
    elif kind == 8:
        lines.insert(0, rng.choice(_HEADERS))
    else:
        lines[a] = lines[a] + lines[b]
    return b"\n".join(lines)


def _ends(rng: Random, data: bytes) -> bytes:
    """Other ends of lines, a byte order mark, another encoding."""
    kind = rng.randrange(7)
    if kind == 0:
        return data.replace(b"\n", b"\r\n")
    if kind == 1:
        return data.replace(b"\n", b"\r")
    if kind == 2:
        return data.replace(b"\n", "\u2028".encode())
    if kind == 3:
        return b"\xef\xbb\xbf" + data
    if kind == 4:
        return data.decode("latin-1").encode("utf-16")
    if kind == 5:
        return data.replace(b" ", b"\t")
    return data.rstrip(b"\n")


def _append(rng: Random, data: bytes) -> bytes:
    return data + rng.choice(
        (word(rng), b"\n" + word(rng) + b"\n", b"\0" * 1000, data[:LONG], b"a: &a [*a, *a]\n" + _BOMB)
    )


_MUTATIONS: tuple[Mutation, ...] = (
    _flip, _set_bytes, _insert, _replace(_WORD), _replace(_WORD), _replace(_NUMBER), _near_number, _near_number,
    _integer, _integer, _truncate, _cut_records, _cut_out, _repeat, _lines, _ends, _append,
)  # fmt: skip
