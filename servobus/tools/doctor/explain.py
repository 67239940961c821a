# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What the texts mean that programs print: dxl_doctor --explain TEXT.

They are in errors.yaml, as forms: {} is what differs. They are found within what a person pasted.
A number is a return code only where nothing else is pasted, or where the text speaks of a result.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from importlib import resources
import re
import textwrap
from typing import NamedTuple

import yaml

from servobus import errors

_FILE = 'errors.yaml'
_PART_MIN_LENGTH = 5               # characters of a pasted part that may stand for a text
_WIDTH = 80
# What stands before a return code; "position error" is a measurement.
_RESULT = (r'(?:result|(?<=[a-z])error|(?<![a-z])'
           r'(?:code|comm(?:unication)?(?:[ _][a-z_]+)?|return(?:ed)?|ret|rc))')


class Explanation(NamedTuple):
    """
    One text. findings: names of rules, the likeliest first; do: what else helps, or ''.

    code: the return code that says the same, or 0. pattern: a regular expression, or ''.
    is_general: whether programs without a servo bus print it too. raised_in: a regular expression
    of the functions that raise it for this cause, or ''.
    """

    text: str
    says: Sequence[str]
    means: str
    findings: Sequence[str]
    also: Sequence[str] = ()
    do: str = ''
    code: int = 0
    pattern: str = ''
    is_general: bool = False
    raised_in: str = ''


@cache
def explanations() -> tuple[Explanation, ...]:
    """Return all texts, in the order of the file."""
    file = resources.files('servobus.tools.doctor') / _FILE
    return tuple(Explanation(**one) for one in yaml.safe_load(file.read_text(encoding='utf-8')))


def find(pasted: str, function: str = '') -> list[Explanation]:
    """
    Return what the text means that a person pasted; function: the one that raised it, if known.

    A known text within it counts, and it within a known text; where there are several, in the
    order in which they stand in it.
    """
    wanted = _plain(pasted)
    found = [(at, one) for one in explanations() if (at := _place(one, wanted)) is not None
             and (not function or re.search(one.raised_in, function.lower()))]
    return [one for _, one in sorted(found, key=lambda pair: pair[0])]


def _place(one: Explanation, wanted: str) -> int | None:
    """Return where a text is found in what was pasted; None if it is not."""
    texts = [_plain(text) for text in (one.text, *one.also)]
    places = [found.start() for pattern in (*map(_form, texts), _code(one.code), one.pattern)
              if pattern and (found := re.search(pattern, wanted))]
    if len(wanted) >= _PART_MIN_LENGTH and any(
            wanted in part for text in texts for part in text.split('{}')):
        places.append(0)
    return min(places, default=None)


def _form(text: str) -> str:
    """Return the regular expression of a text: a number at its end is that number."""
    return '.*?'.join(map(re.escape, text.split('{}'))) + r'(?!\d)' * text[-1].isdigit()


def _code(code: int) -> str:
    return rf'^\W*{code}\W*$|{_RESULT}\W*?{code}\b' if code else ''


def nearest(pasted: str) -> str:
    """Return the known text that is most like what was pasted, '' if none is."""
    texts = {_plain(one.text): one.text for one in explanations()}
    return texts.get(errors.nearest(_plain(pasted), texts), '')


def _plain(text: str) -> str:
    return ' '.join(text.casefold().split())


def in_words(found: Sequence[Explanation]) -> str:
    """Return what is printed."""
    paragraphs = []
    for one in found:
        title = one.text.replace('{}', '...')
        paragraphs += [f'{title}\n  printed by {", ".join(one.says)}', _paragraph(one.means)]
        if one.findings:
            names = ', '.join(name.replace('_', ' ') for name in one.findings)
            paragraphs.append(_paragraph(f'Possible causes, the likeliest first: {names}.'))
        if one.do:
            paragraphs.append(_paragraph(one.do))
    if any(one.findings for one in found):
        paragraphs.append(_paragraph('dxl_doctor run -- COMMAND listens, and says which it is.'))
    return '\n\n'.join(paragraphs)


def _paragraph(text: str) -> str:
    return textwrap.fill(text, _WIDTH, initial_indent='  ', subsequent_indent='  ')
