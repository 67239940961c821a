# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The one screen of dxl_doctor: lines of text for a width and a height. Pure.

Three findings are shown in full, the others in a line each. Where it is too much, the devices that
are well are counted rather than listed, then what is unknown is cut, then fewer are in full.
"""

from __future__ import annotations

from collections.abc import Sequence
import textwrap

from msg_defs.reports import Level
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
_HEARD_LINES = 5
_UNKNOWN_LINES = 3
_CYCLES = 2
_INDENT = '    '


def screen(verdict: Verdict, colours: bool = False, width: int = WIDTH,
           height: int = HEIGHT) -> list[str]:
    """Return the lines, none longer than width columns (40 to WIDTH_MAX)."""
    width = min(max(WIDTH_MIN, width), WIDTH_MAX)
    head = [paint(_head(verdict, width), BOLD if colours else None)]
    if verdict.quiet:
        return [*head, '', 'Nothing was heard:', *_bullets(verdict.quiet, width)]
    unknown = _unknown(verdict.unknown, width)
    cycles = [fit(f'  {one}', width) for one in verdict.cycles[:_CYCLES]]
    for most in range(FULL_FINDINGS_MAX, 0, -1):       # the next step is never cut
        wrong = _found(verdict, colours, width, most, _EVIDENCE_LINES if height > HEIGHT else 1)
        room = height - len(head) - len(wrong) - len(cycles) - 3
        if room > 0:
            break
    unknown = unknown[:max(0, room - 1)] if room > 3 else []
    heard = _heard(verdict, width, max(1, min(_HEARD_LINES, room - len(unknown))))
    return [*head, '', *heard, *cycles, '', *wrong, *unknown]


def _head(verdict: Verdict, width: int) -> str:
    facts = ''.join(f'  {fact}' for fact in verdict.head)
    return fit(fit(f'dxl_doctor  {verdict.source}', max(20, width - len(facts))) + facts, width)


def _heard(verdict: Verdict, width: int, most: int) -> list[str]:
    heard = f'Heard, {verdict.protocol}:' if verdict.protocol else 'Heard:'
    if not verdict.heard:
        return [f'{heard} no device']
    lines = [fit(f'  {one.who}  {one.what}', width)
             for one in sorted(verdict.heard,
                               key=lambda one: one.level in (Level.OK, Level.STALE))]
    if len(lines) > most:
        cut = max(0, most - 1)
        lines = [*lines[:cut], f'  and {len(lines) - cut} more lines: --json lists all']
    return [fit(heard, width), *lines]


def _found(verdict: Verdict, colours: bool, width: int, most: int, evidence: int) -> list[str]:
    """Return the lines of what is wrong or may be; at most so many of each in full."""
    not_sure = _not_sure(verdict.not_sure, colours, width, most)
    if not verdict.wrong:
        return not_sure or [_well(colours)]
    wrong = _wrong(verdict.wrong, colours, width, most, evidence)
    if verdict.wrong[0].level is not Level.OK:
        return [*wrong, *not_sure]
    return [*(not_sure or [_well(colours)]), *wrong]


def _well(colours: bool) -> str:
    return paint('Nothing wrong that listening can find', GREEN if colours else None)


def _not_sure(points: Sequence[OpenPoint], colours: bool, width: int, most: int) -> list[str]:
    lines = ['Not sure:'] if points else []
    for one in points[:most]:
        rule = f': {one.rule.replace("_", " ")}' if one.rule else ''
        title = fit(f'  {one.who}{rule}', width)
        lines += [paint(title, COLOURS[Level.WARN] if colours else None),
                  *_wrapped(one.message, width, 2), *_wrapped(f'Try: {one.step}', width)]
    if len(points) > most:
        lines.append(f'  and {len(points) - most} more: --json lists all')
    return lines


def _wrong(entries: Sequence[Trouble], colours: bool, width: int, most: int,
           evidence: int) -> list[str]:
    lines = ['Advice:' if entries[0].level is Level.OK else 'Wrong:']
    for number, entry in enumerate(entries[:most], 1):
        lines += _in_full(number, entry, colours, width, evidence)
    rest = entries[most:]
    shown = rest if len(rest) <= FULL_FINDINGS_MAX else rest[:FULL_FINDINGS_MAX - 1]
    lines += [fit(f'  {_title(number, entry)}: {entry.message}', width)
              for number, entry in enumerate(shown, most + 1)]
    if len(shown) < len(rest):
        lines.append(f'  and {len(rest) - len(shown)} more: --json lists all')
    return lines


def _in_full(number: int, entry: Trouble, colours: bool, width: int, evidence: int) -> list[str]:
    title = fit(f'  {_title(number, entry)}', width)
    lines = [paint(title, COLOURS.get(entry.level) if colours else None)]
    lines += _wrapped(entry.message, width, 2)
    if entry.evidence and entry.rule:
        lines += _wrapped(f'Evidence: {entry.evidence}', width, evidence)
    elif entry.evidence:               # the error of a program
        lines += _wrapped(f'This means: {entry.evidence}', width, 3)
    return lines


def _title(number: int, entry: Trouble) -> str:
    level = {Level.OK: 'advice', Level.WARN: 'warning'}.get(entry.level, entry.level.name.lower())
    cause = f': {entry.rule.replace("_", " ")}' if entry.rule else ''
    return f'{number} {level}, {entry.who}{cause}'


def _unknown(unknown: Sequence[str], width: int) -> list[str]:
    if not unknown:
        return []
    lines = _bullets(unknown, width)
    if len(lines) > _UNKNOWN_LINES:
        lines = [*lines[:_UNKNOWN_LINES - 1], '  and more: --json lists all']
    return ['', 'Cannot tell:', *lines]


def _bullets(texts: Sequence[str], width: int) -> list[str]:
    return [line for text in texts
            for line in textwrap.wrap(text, width, initial_indent='- ', subsequent_indent='  ')]


def _wrapped(text: str, width: int, most: int | None = None) -> list[str]:
    """Break a text into at most so many lines; None: as many as it needs."""
    lines = textwrap.wrap(text, width - len(_INDENT))
    if most is not None and len(lines) > most:
        lines = [*lines[:most - 1], fit(' '.join(lines[most - 1:]), width - len(_INDENT))]
    return [_INDENT + line for line in lines]
