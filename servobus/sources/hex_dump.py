# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Lines of xxd, hexdump and od, one by one; `*` is for lines like the one before it.

How many is in the offsets, which are octal (od) or hexadecimal; where that is not known, it is not
guessed.
"""
from __future__ import annotations

import re

REPEATED_MAX_BYTES = 1 << 24
OD_DIGITS = 7                      # an offset has: od, in octal; hexdump, with words
_LINE = re.compile(r'([0-9a-f]{6,16})(:? {1,3})((?:[0-9a-f]{2,4} {1,2})*[0-9a-f]{2,4})(?: .*)?',
                   re.IGNORECASE)
_END = re.compile(r'[0-9a-f]{6,16}', re.IGNORECASE)
FOLDED = '`*` leaves lines out: print them with -v'


class HexDump:
    """Takes the lines of a text; note: what of them was left out."""

    def __init__(self) -> None:
        self.note = ''
        self._offset, self._row = '', b''
        self._base = 0                         # the offsets have; 0: not known yet
        self._is_folded = False

    def read(self, line: str) -> bytes | None:
        """Return what a line adds, None where it is no line of a dump."""
        text = line.strip()
        if text == '*' and self._row:
            self._is_folded = True
            return b''
        found = _LINE.fullmatch(text)
        if found is None and not (self._row and _END.fullmatch(text)):
            return None
        offset, row = (found[1], _row(found)) if found else (text, b'')
        has_words = found is not None and len(found[3].split()[0]) == 4
        repeated = self._repeated(offset, has_words) if self._row else b''
        self._offset, self._row, self._is_folded = offset, row, False
        return repeated + row

    def _repeated(self, offset: str, has_words: bool) -> bytes:
        """Return the bytes of the lines that were left out before an offset."""
        if not self._is_folded:
            self._base = next((base for base in (16, 8) if self._gap(offset, base) == 0),
                              self._base)
            return b''
        base = self._base or (16 if len(offset) != OD_DIGITS else 0 if has_words else 8)
        gap = self._gap(offset, base) if base else -1
        if not 0 < gap <= REPEATED_MAX_BYTES or gap % len(self._row):
            self.note = FOLDED
            return b''
        return self._row * (gap // len(self._row))

    def _gap(self, offset: str, base: int) -> int:
        """Return how many bytes are between the line before and an offset."""
        try:
            return int(offset, base) - int(self._offset, base) - len(self._row)
        except ValueError:
            return -1


def _row(found: re.Match[str]) -> bytes:
    """Return the bytes of a line."""
    has_colon = ':' in found[2]
    groups = (re.split(r'  (?![0-9a-fA-F]{2} )', found[3])[0] if has_colon else found[3]).split()
    # hexdump and od -x show numbers of two bytes, xxd shows two bytes after a colon.
    is_swapped = not has_colon and all(len(one) == 4 for one in groups)
    return b''.join(bytes.fromhex(one)[::-1 if is_swapped else 1] for one in groups
                    if len(one) % 2 == 0)
