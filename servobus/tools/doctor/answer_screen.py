# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The one screen of dxl_doctor: lines of text for a width and a height. Pure.

Three findings are shown in full, the others in a line each. Where it is too much, what is unknown
is cut, then devices alike share a line, then fewer findings are in full. No device is ever left
out; without a height nothing is.
"""

from __future__ import annotations

from collections.abc import Sequence
import textwrap
from typing import NamedTuple

from msg_defs.diagnostics import Level
from servobus.tools.cli import WIDTH_MAX
from servobus.tools.doctor.verdict import OpenPoint
from servobus.tools.doctor.verdict import Trouble
from servobus.tools.doctor.verdict import Verdict
from servobus.tools.dump.packet_lines import BOLD
from servobus.tools.dump.packet_lines import fit
from servobus.tools.dump.packet_lines import GREEN
from servobus.tools.dump.packet_lines import paint
from servobus.tools.dump.screen import COLOURS

WIDTH, HEIGHT = 80, 23             # the shell takes one of the 24 lines
WIDTH_MIN = 40
FULL_FINDINGS_MAX = 3              # findings
_EVIDENCE_LINES = 3                # where there are more lines than HEIGHT; else one
_UNKNOWN_LINES = 3
_CYCLES = 2
_INDENT = '    '


class _Lengths(NamedTuple):
    """How many findings are in full, and how many lines each text of them has; None: all."""

    findings: int | None = None
    message: int | None = None
    evidence: int | None = None
    meaning: int | None = None


def screen(verdict: Verdict, colours: bool = False, width: int = WIDTH,
           height: int | None = HEIGHT) -> list[str]:
    """Return the lines, none longer than width columns (40 to WIDTH_MAX); height None: all."""
    width = min(max(WIDTH_MIN, width), WIDTH_MAX)
    head = [paint(_head(verdict, width), BOLD if colours else None)]
    if verdict.quiet:
        return [*head, '', 'Nothing was heard:', *_bullets(verdict.quiet, width)]
    if height is None:
        return [*head, '', *_heard(verdict, width), *_items(verdict.cycles, width), '',
                *_found(verdict, colours, width, _Lengths()), *_unknown(verdict.unknown, width)]
    cycles = [fit(f'  {one}', width) for one in verdict.cycles[:_CYCLES]]
    for is_joined, most in ((False, FULL_FINDINGS_MAX),
                            *((True, most) for most in range(FULL_FINDINGS_MAX, 0, -1))):
        heard = _heard(verdict, width, is_joined)
        wrong = _found(verdict, colours, width, _Lengths(    # the next step is never cut
            most, 2, _EVIDENCE_LINES if height > HEIGHT else 1, 3))
        room = height - len(head) - len(heard) - len(cycles) - len(wrong) - 2
        if room >= 0:
            break
    unknown = _unknown(verdict.unknown, width, _UNKNOWN_LINES)[:max(0, room)] if room > 2 else []
    return [*head, '', *heard, *cycles, '', *wrong, *unknown]


def _head(verdict: Verdict, width: int) -> str:
    facts = ''.join(f'  {fact}' for fact in verdict.head)
    return fit(fit(f'dxl_doctor  {verdict.source}', max(20, width - len(facts))) + facts, width)


def _heard(verdict: Verdict, width: int, is_joined: bool = False) -> list[str]:
    """Return the lines of the devices, with trouble first; is_joined: a line for all alike."""
    heard = f'Heard, {verdict.protocol}:' if verdict.protocol else 'Heard:'
    if not verdict.heard:
        return [f'{heard} no device']
    groups = sorted(verdict.heard, key=lambda one: one.level in (Level.OK, Level.STALE))
    texts = [f'{one.who}  {one.what}' for one in groups]
    if is_joined:
        alike: dict[str, list[str]] = {}
        for one in groups:
            alike.setdefault(one.what, []).append(one.who)
        texts = [f'{", ".join(who)}  {what}' for what, who in alike.items()]
    return [fit(heard, width), *_items(texts, width)]


def _found(verdict: Verdict, colours: bool, width: int, lengths: _Lengths) -> list[str]:
    """Return the lines of what is wrong or may be."""
    not_sure = _not_sure(verdict.not_sure, colours, width, lengths)
    if not verdict.wrong:
        return not_sure or [_well(colours)]
    wrong = _wrong(verdict.wrong, colours, width, lengths)
    if verdict.wrong[0].level is not Level.OK:
        return [*wrong, *not_sure]
    return [*(not_sure or [_well(colours)]), *wrong]


def _well(colours: bool) -> str:
    return paint('Nothing wrong that listening can find', GREEN if colours else None)


def _not_sure(points: Sequence[OpenPoint], colours: bool, width: int,
              lengths: _Lengths) -> list[str]:
    lines = ['Not sure:'] if points else []
    for one in points[:lengths.findings]:
        rule = f': {one.rule.replace("_", " ")}' if one.rule else ''
        lines += [*_heading(f'{one.who}{rule}', Level.WARN, colours, width, lengths),
                  *_wrapped(one.message, width, lengths.message),
                  *_wrapped(f'Try: {one.step}', width)]
    left = len(points) - len(points[:lengths.findings])
    if left:
        lines.append(f'  and {left} more: --full lists all')
    return lines


def _wrong(entries: Sequence[Trouble], colours: bool, width: int, lengths: _Lengths) -> list[str]:
    lines = ['Advice:' if entries[0].level is Level.OK else 'Wrong:']
    in_full = entries[:lengths.findings]
    for number, entry in enumerate(in_full, 1):
        lines += _in_full(number, entry, colours, width, lengths)
    rest = entries[len(in_full):]
    shown = rest if len(rest) <= FULL_FINDINGS_MAX else rest[:FULL_FINDINGS_MAX - 1]
    lines += [fit(f'  {_title(number, entry)}: {entry.message}', width)
              for number, entry in enumerate(shown, len(in_full) + 1)]
    if len(shown) < len(rest):
        lines.append(f'  and {len(rest) - len(shown)} more: --full lists all')
    return lines


def _in_full(number: int, entry: Trouble, colours: bool, width: int,
             lengths: _Lengths) -> list[str]:
    lines = _heading(_title(number, entry), entry.level, colours, width, lengths)
    lines += _wrapped(entry.message, width, lengths.message)
    if entry.evidence and entry.rule:
        lines += _wrapped(f'Evidence: {entry.evidence}', width, lengths.evidence)
    elif entry.evidence:               # the error of a program
        lines += _wrapped(f'This means: {entry.evidence}', width, lengths.meaning)
    return lines


def _heading(title: str, level: Level, colours: bool, width: int, lengths: _Lengths) -> list[str]:
    lines = _items([title], width) if lengths == _Lengths() else [fit(f'  {title}', width)]
    return [paint(line, COLOURS.get(level) if colours else None) for line in lines]


def _title(number: int, entry: Trouble) -> str:
    level = {Level.OK: 'advice', Level.WARN: 'warning'}.get(entry.level, entry.level.name.lower())
    cause = f': {entry.rule.replace("_", " ")}' if entry.rule else ''
    return f'{number} {level}, {entry.who}{cause}'


def _unknown(unknown: Sequence[str], width: int, most: int | None = None) -> list[str]:
    if not unknown:
        return []
    lines = _bullets(unknown, width)
    if most is not None and len(lines) > most:
        lines = [*lines[:most - 1], '  and more: --full lists all']
    return ['', 'Cannot tell:', *lines]


def _bullets(texts: Sequence[str], width: int) -> list[str]:
    return [line for text in texts
            for line in textwrap.wrap(text, width, initial_indent='- ', subsequent_indent='  ')]


def _items(texts: Sequence[str], width: int) -> list[str]:
    return [line for text in texts
            for line in textwrap.wrap(text, width, initial_indent='  ', subsequent_indent=_INDENT)]


def _wrapped(text: str, width: int, most: int | None = None) -> list[str]:
    """Break a text into at most so many lines; None: as many as it needs."""
    lines = textwrap.wrap(text, width - len(_INDENT))
    if most is not None and len(lines) > most:
        lines = [*lines[:most - 1], fit(' '.join(lines[most - 1:]), width - len(_INDENT))]
    return [_INDENT + line for line in lines]
