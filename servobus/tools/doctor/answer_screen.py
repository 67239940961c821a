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
_MESSAGE_LINES, _MEANING_LINES = 2, 3
_EVIDENCE_LINES = 3                # where there are more lines than HEIGHT; else one
_UNKNOWN_LINES = 3
_CYCLES = 2
_INDENT = '    '


class _Format(NamedTuple):
    """findings: how many are in full, None: all, and no text is cut; evidence: lines of it."""

    width: int
    colours: bool
    findings: int | None = None
    evidence: int = 0

    def paint(self, text: str, colour: str | None) -> str:
        return paint(text, colour if self.colours else None)


def screen(verdict: Verdict, colours: bool = False, width: int = WIDTH,
           height: int | None = HEIGHT) -> list[str]:
    """Return the lines, none longer than width columns (40 to WIDTH_MAX); height None: all."""
    width = min(max(WIDTH_MIN, width), WIDTH_MAX)
    form = _Format(width, colours)
    head = [form.paint(_head(verdict, width), BOLD)]
    if verdict.quiet:
        return [*head, '', 'Nothing was heard:', *_items(verdict.quiet, width, '- ', '  ')]
    if height is None:
        return [*head, '', *_heard(verdict, width), *_items(verdict.cycles, width), '',
                *_found(verdict, form), *_unknown(verdict.unknown, width)]
    cycles = [fit(f'  {one}', width) for one in verdict.cycles[:_CYCLES]]
    evidence = _EVIDENCE_LINES if height > HEIGHT else 1
    for is_joined, most in ((False, FULL_FINDINGS_MAX),
                            *((True, most) for most in range(FULL_FINDINGS_MAX, 0, -1))):
        heard = _heard(verdict, width, is_joined)
        wrong = _found(verdict, _Format(width, colours, most, evidence))
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


def _found(verdict: Verdict, form: _Format) -> list[str]:
    """Return the lines of what is wrong or may be; advice comes last."""
    wrong = [one for one in verdict.wrong if one.level is not Level.OK]
    advice = [one for one in verdict.wrong if one.level is Level.OK]
    lines = [*_entries('Wrong:', wrong, 1, form), *_not_sure(verdict.not_sure, form)]
    return [*(lines or [form.paint('Nothing wrong that listening can find', GREEN)]),
            *_entries('Advice, no error:', advice, len(wrong) + 1, form)]


def _not_sure(points: Sequence[OpenPoint], form: _Format) -> list[str]:
    shown = points[:form.findings]
    lines = ['Not sure:'] if points else []
    for one in shown:
        lines += [*_heading(f'{one.who}{_cause(one.rule)}', Level.WARN, form),
                  *_wrapped(one.message, form, _MESSAGE_LINES),
                  *_wrapped(f'Try: {one.step}', form)]       # the next step is never cut
    return lines + _more(len(points) - len(shown))


def _entries(heading: str, entries: Sequence[Trouble], first: int, form: _Format) -> list[str]:
    """Return the lines of findings under their heading; first: the number of the first one."""
    if not entries:
        return []
    lines = [heading]
    in_full = entries[:form.findings and max(0, form.findings + 1 - first)]
    for number, entry in enumerate(in_full, first):
        lines += _in_full(number, entry, form)
    rest = entries[len(in_full):]
    shown = rest if len(rest) <= FULL_FINDINGS_MAX else rest[:FULL_FINDINGS_MAX - 1]
    lines += [fit(f'  {_title(number, entry)}: {entry.message}', form.width)
              for number, entry in enumerate(shown, first + len(in_full))]
    return lines + _more(len(rest) - len(shown))


def _more(count: int) -> list[str]:
    return [f'  and {count} more: --full lists all'] if count else []


def _in_full(number: int, entry: Trouble, form: _Format) -> list[str]:
    lines = [*_heading(_title(number, entry), entry.level, form),
             *_wrapped(entry.message, form, _MESSAGE_LINES)]
    if entry.evidence and entry.rule:
        lines += _wrapped(f'Evidence: {entry.evidence}', form, form.evidence)
    elif entry.evidence:               # the error of a program
        lines += _wrapped(f'This means: {entry.evidence}', form, _MEANING_LINES)
    return lines


def _heading(title: str, level: Level, form: _Format) -> list[str]:
    lines = [fit(f'  {title}', form.width)] if form.findings else _items([title], form.width)
    return [form.paint(line, COLOURS.get(level)) for line in lines]


def _title(number: int, entry: Trouble) -> str:
    level = {Level.OK: 'advice', Level.WARN: 'warning'}.get(entry.level, entry.level.name.lower())
    return f'{number} {level}, {entry.who}{_cause(entry.rule)}'


def _cause(rule: str) -> str:
    return f': {rule.replace("_", " ")}' if rule else ''


def _unknown(unknown: Sequence[str], width: int, most: int | None = None) -> list[str]:
    if not unknown:
        return []
    lines = _items(unknown, width, '- ', '  ')
    if most is not None and len(lines) > most:
        lines = [*lines[:most - 1], '  and more: --full lists all']
    return ['', 'Cannot tell:', *lines]


def _items(texts: Sequence[str], width: int, first: str = '  ', others: str = _INDENT
           ) -> list[str]:
    """Break texts into lines; first and others: how the lines of each begin."""
    return [line for text in texts for line in textwrap.wrap(
        text, width, initial_indent=first, subsequent_indent=others)]


def _wrapped(text: str, form: _Format, most: int = 0) -> list[str]:
    """Break a text into at most so many lines, where texts are cut; 0: as many as it needs."""
    width = form.width - len(_INDENT)
    lines = textwrap.wrap(text, width)
    if form.findings and most and len(lines) > most:
        lines = [*lines[:most - 1], fit(' '.join(lines[most - 1:]), width)]
    return [_INDENT + line for line in lines]
