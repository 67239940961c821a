# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What the texts mean that programs print: dxl_doctor --explain TEXT.

They are in errors.yaml, as forms: {} is what differs. They are found within what a person pasted.
"""

from __future__ import annotations

from collections.abc import Sequence
from difflib import SequenceMatcher
from functools import cache
from importlib import resources
import re
import textwrap
from typing import NamedTuple

import yaml

_FILE = 'errors.yaml'
_PART_MIN_LENGTH = 5               # characters of a pasted part that may stand for a text
_LIKENESS_MIN = 0.6                # alike enough for a guess, 0 to 1
_WIDTH = 80


class Explanation(NamedTuple):
    """One text. findings: names of rules, the likeliest first; do: what else helps, or ''."""

    text: str
    says: Sequence[str]
    means: str
    findings: Sequence[str]
    also: Sequence[str] = ()
    do: str = ''


@cache
def explanations() -> tuple[Explanation, ...]:
    """Return all texts, in the order of the file."""
    file = resources.files('servobus.tools.doctor') / _FILE
    return tuple(Explanation(**one) for one in yaml.safe_load(file.read_text(encoding='utf-8')))


def find(pasted: str) -> list[Explanation]:
    """
    Return what the text means that a person pasted.

    A known text within it counts, and it within a known text; where there are several, in the
    order in which they stand in it.
    """
    wanted = _plain(pasted)
    found = [(at, one) for one in explanations() if (at := _place(one, wanted)) is not None]
    return [one for _, one in sorted(found, key=lambda pair: pair[0])]


def _place(one: Explanation, wanted: str) -> int | None:
    """Return where a text is found in what was pasted; None if it is not."""
    places = []
    for text in map(_plain, (one.text, *one.also)):
        parts = text.split('{}')
        found = re.search('.*?'.join(map(re.escape, parts)), wanted)
        if found:
            places.append(found.start())
        elif len(wanted) >= _PART_MIN_LENGTH and any(wanted in part for part in parts):
            places.append(0)
    return min(places, default=None)


def nearest(pasted: str) -> str:
    """Return the known text that is most like what was pasted, '' if none is."""
    def likeness(text: str) -> float:
        return SequenceMatcher(None, _plain(text), _plain(pasted)).ratio()
    best = max((one.text for one in explanations()), key=likeness)
    return best if likeness(best) >= _LIKENESS_MIN else ''


def _plain(text: str) -> str:
    return ' '.join(text.casefold().split())


def lines(found: Sequence[Explanation]) -> list[str]:
    """Return what is printed."""
    text: list[str] = []
    for one in found:
        text += [*([''] if text else []), one.text, f'  printed by {", ".join(one.says)}', '',
                 *_paragraph(one.means)]
        if one.findings:
            names = ', '.join(name.replace('_', ' ') for name in one.findings)
            text += ['', *_paragraph(f'Possible causes, the likeliest first: {names}.')]
        text += ['', *_paragraph(one.do)] if one.do else []
    listen = 'dxl_doctor run -- COMMAND listens, and says which it is.'
    return [*text, '', *_paragraph(listen)] if any(one.findings for one in found) else text


def _paragraph(text: str) -> list[str]:
    return textwrap.wrap(text, _WIDTH, initial_indent='  ', subsequent_indent='  ')
