"""Read what macOS looks at in a universal library, where there is no Mac to load it.

Names and layouts are those of mach-o/fat.h, mach-o/loader.h and kern/cs_blobs.h.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterator
from dataclasses import dataclass

PROCESSORS = {0x01000007: "x86_64", 0x0100000C: "arm64"}
LC_CODE_SIGNATURE, LC_BUILD_VERSION = 0x1D, 0x32
LC_DYLD_INFO_ONLY, LC_DYLD_EXPORTS_TRIE = 0x80000022, 0x80000033
CODE_DIRECTORY, SHA256 = 0xFADE0C02, 2


@dataclass(frozen=True)
class Part:
    """What the library of one processor says of itself."""

    macos: str  # the oldest version that loads it
    signed: bool  # whether there is a signature, and all pages are as signed
    names: frozenset[str]  # what it exports


def parts(library: bytes) -> dict[str, Part]:
    """The parts of a universal library by their processors."""
    found = {}
    _, count = struct.unpack_from(">2I", library)
    for i in range(count):
        processor, _, offset, size, _ = struct.unpack_from(">5I", library, 8 + 20 * i)
        found[PROCESSORS[processor]] = _part(library[offset : offset + size])
    return found


def _part(content: bytes) -> Part:
    macos, signed, names, at = "", False, frozenset[str](), 32
    for _ in range(struct.unpack_from("<I", content, 16)[0]):
        command, length, *words = struct.unpack_from("<4I", content, at)
        if command == LC_BUILD_VERSION:
            macos = f"{words[1] >> 16}.{words[1] >> 8 & 255}"
        if command == LC_CODE_SIGNATURE:
            signed = _as_signed(content, words[0])
        if command == LC_DYLD_INFO_ONLY:
            words = [*struct.unpack_from("<2I", content, at + 40)]
        if command in (LC_DYLD_INFO_ONLY, LC_DYLD_EXPORTS_TRIE) and words[1]:
            trie = content[words[0] : words[0] + words[1]]
            names = frozenset(name.decode().removeprefix("_") for name in _names(trie, 0, b""))
        at += length
    return Part(macos, signed, names)


def _names(trie: bytes, at: int, before: bytes) -> Iterator[bytes]:
    """The exported names below a node, each of which holds the rest of its names."""
    size, at = _number(trie, at)
    if size:
        yield before
    at += size
    children, at = trie[at], at + 1
    for _ in range(children):
        end = trie.index(0, at)
        rest = trie[at:end]
        child, at = _number(trie, end + 1)
        yield from _names(trie, child, before + rest)


def _number(content: bytes, at: int) -> tuple[int, int]:
    """A number of seven bits a byte (ULEB128), and where it ends."""
    value = shift = 0
    while True:
        value |= (content[at] & 127) << shift
        shift += 7
        at += 1
        if content[at - 1] < 128:
            return value, at


def _as_signed(content: bytes, at: int) -> bool:
    """Whether the pages have the sums that the signature lists; Apple's processors insist."""
    count = struct.unpack_from(">I", content, at + 8)[0]
    for i in range(count):
        start = at + struct.unpack_from(">I", content, at + 16 + 8 * i)[0]
        magic, _, _, _, sums, _, _, pages, limit = struct.unpack_from(">9I", content, start)
        if magic != CODE_DIRECTORY:
            continue
        size, kind, _, log = struct.unpack_from("4B", content, start + 36)
        listed = content[start + sums : start + sums + pages * size]
        held = [content[n : min(n + (1 << log), limit)] for n in range(0, limit, 1 << log)]
        return kind == SHA256 and listed == b"".join(hashlib.sha256(p).digest() for p in held)
    return False
