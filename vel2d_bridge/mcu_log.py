# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What the MCU says on the line back, as lines fit for a log.

Text is cut into lines; what is not text is counted, never printed. Bounded: a babbling MCU costs
no memory and a few lines per second. The two lines by which the firmware of the mecarover thesis
refuses a frame are counted instead of logged, and the report of an MCU with the receiver of
firmware/ becomes status values. An MCU that reads commands in text is known by its answers to
frames. Pure; `now` is monotonic ns.
"""
from __future__ import annotations

from collections import deque
import re

from msg_defs.mcu_report import McuReport
from msg_defs.mcu_report import parse_report
from msg_defs.mcu_report import STOPPED
from msg_defs.mcu_report import VERSION
from msg_defs.nanoseconds import NS_PER_S

_LONGEST = 200                  # bytes of a line
_KEPT = 5                       # lines between two that are taken
_GARBAGE_PERIOD = 10 * NS_PER_S  # between complaints
_REFUSED_FOR = 10 * NS_PER_S    # after its last word a refusal is a complaint for so long
_DRIVES_MIN = 5                 # frames: fewer refused ones may be an accident
_DRIVES_KEPT = 200              # frames that say whether commands to drive are refused: about 10 s
CRC_MISMATCH = 'crc mismatch'
TOO_FEW_BYTES = 'insufficient bytes'
_KEYS = ('MCU state', 'MCU good frames', 'MCU bad frames', 'MCU refused frames',
         'MCU watchdog stops')
_COLOUR = re.compile(rb'\x1b\[[0-9;]*[A-Za-z]')
_ANSWERS = 10                   # that a command is not understood: so many show what the MCU reads
_ANSWERS_WITHIN = 60 * NS_PER_S
_NOT_UNDERSTOOD = re.compile(
    r'(invalid|unknown|unrecogni[sz]ed|unsupported|illegal|bad) (command|cmd)'
    r'|(command|cmd) (not (found|recogni[sz]ed|supported)|unknown|invalid)'
    r'|not understood|syntax ?error', re.IGNORECASE)
_ERROR = re.compile(r'\s*(err(or)?|nac?k|\?+)[.!:\s]*', re.IGNORECASE)   # judged by its rate too


_REMEDIES = {CRC_MISMATCH: 'check cable and ground',
             TOO_FEW_BYTES: 'check the cable, and that no console, login or other program writes '
                           'to the port'}


class _Rise:
    """When a count rose last; known: what it was before, None: it is not known."""

    def __init__(self, known: int | None = 0) -> None:
        self._known = known
        self._rose_at = -_REFUSED_FOR

    def is_recent(self, count: int, now: int) -> bool:
        """Take the count as it is now; tell whether it rose in the last 10 s."""
        if self._known is not None and count > self._known:
            self._rose_at = now
        self._known = count
        return now - self._rose_at < _REFUSED_FOR


class McuLog:
    """Fed by the port's thread, emptied by the node's."""

    def __init__(self) -> None:
        self.reset()
        self._refusals = {words: _Rise() for words in _REMEDIES}
        self._drive_refusals = _Rise()
        self._watchdog_stops = _Rise(None)          # those before the first report are not ours
        self._partial = b''
        self._kept: deque[str] = deque()
        self._skipped = 0
        self._taken = -NS_PER_S
        self._complained = -_GARBAGE_PERIOD
        self._report: McuReport | None = None
        self._reported_at = 0

    def reset(self) -> None:
        """Start all counts at 0."""
        self.bytes = 0
        self.lines = 0
        self.garbage_bytes = 0
        self.refused = dict.fromkeys(_REMEDIES, 0)      # frames, as the MCU says
        self._known_garbage = 0
        self.drives = 0             # frames sent that are not stops
        self._bad = 0               # frames, as its reports say
        self._drives_before = self._refused_before = 0
        self.frames = 0             # sent
        self._answers: deque[tuple[int, int, int]] = deque(maxlen=_ANSWERS)
        self._answer, self._answered_at = '', 0     # the newest that shows what the MCU reads

    def feed(self, chunk: bytes, now: int = 0) -> None:
        """Take what came in."""
        self.bytes += len(chunk)
        *lines, self._partial = (self._partial + chunk).replace(b'\r', b'\n').split(b'\n')
        while len(self._partial) > _LONGEST:
            lines.append(self._partial[:_LONGEST])
            self._partial = self._partial[_LONGEST:]
        for line in filter(None, lines):
            self._keep(line, now)

    def _keep(self, line: bytes, now: int) -> None:
        text = _COLOUR.sub(b'', line).replace(b'\t', b' ').decode(errors='replace')
        self._judge_answer(text, now)       # some firmware quotes the bytes that it does not know
        if '\ufffd' in text or not text.isprintable():
            self.garbage_bytes += len(line)
            return
        self.lines += 1
        if (report := parse_report(text)) is not None:
            if self._report is not None:            # what it counted before the first is not ours
                self._bad += max(0, report.bad - self._report.bad)
            self._report, self._reported_at = report, now
            return
        for words in self.refused:
            if words in text.lower():
                self.refused[words] += 1
                return
        if len(self._kept) < _KEPT:
            self._kept.append(text[:_LONGEST])
        else:
            self._skipped += 1

    def _judge_answer(self, text: str, now: int) -> None:
        words = _NOT_UNDERSTOOD.search(text) or _ERROR.fullmatch(text)
        if words is None or self._report is not None or any(self.refused.values()):
            return
        answers = self._answers             # the node's thread may put another one there
        answers.append((now, self.lines, self.frames))
        since, lines, frames = answers[0]
        is_most = self.lines - lines < 2 * _ANSWERS
        is_of_frames = _ANSWERS / 2 <= self.frames - frames < 2 * _ANSWERS
        if (len(answers) == _ANSWERS and now - since < _ANSWERS_WITHIN and is_most
                and (is_of_frames or words.re is _NOT_UNDERSTOOD)):
            self._answer, self._answered_at = words.group().strip(), now

    def take_lines(self, now: int) -> list[str]:
        """Return the lines since the last call, at most a few per second."""
        if now - self._taken < NS_PER_S:
            return []
        self._taken = now
        lines = []
        while self._kept:
            lines.append(self._kept.popleft())
        if self._skipped:
            lines.append(f'... and {self._skipped} more lines')
            self._skipped = 0
        return lines

    def complaints(self, now: int, crc_input: str) -> list[str]:
        """
        Return why the MCU refuses frames, as far as it said so in the last 10 s.

        `crc_input` is the value of the parameter that the bridge does not have now.
        """
        refusals = [f'the MCU refuses frames with "{words}"; {_REMEDIES[words]}'
                    for words, count in self.refused.items()
                    if self._refusals[words].is_recent(count, now)]
        return (self._wrong_firmware(now) or self.refused_drives(now, crc_input)
                or [*refusals, *self._report_complaints(now)])

    def _wrong_firmware(self, now: int) -> list[str]:
        if not self._answer or now - self._answered_at >= _REFUSED_FOR:
            return []
        return [f'the MCU answers frames with "{self._answer}", so it reads commands in text and '
                'not the frame; put a receiver as in docs/firmware.md into it']

    def refused_drives(self, now: int, crc_input: str) -> list[str]:
        """
        Return that the MCU refuses most commands to drive, where it does.

        24 zero bytes have the same CRC in both ways: with the wrong crc_input each stop is
        accepted and no other frame.
        """
        refused = self.refused[CRC_MISMATCH] + self._bad
        is_recent = self._drive_refusals.is_recent(refused, now)
        drives = self.drives - self._drives_before
        refused -= self._refused_before
        if drives > _DRIVES_KEPT:
            self._drives_before += drives // 2
            self._refused_before += refused // 2
        if refused < _DRIVES_MIN or not 0 < drives < 2 * refused or not is_recent:
            return []
        return ['the MCU refuses the commands to drive, so the rover does not move; set crc_input '
                f'to {crc_input} if it accepts the stops, else check cable, ground and baud']

    def _report_complaints(self, now: int) -> list[str]:
        report = self._report
        if report is None or now - self._reported_at >= _REFUSED_FOR:
            return []
        if report.version != VERSION:
            return [f'the receiver of the MCU has version {report.version}, this bridge reads '
                    f'version {VERSION}; put firmware/ of this release into the MCU']
        if not self._watchdog_stops.is_recent(report.stops, now) and report.state != STOPPED:
            return []
        return ['the watchdog of the MCU stopped the rover, because no good frame came; check '
                'cable and ground, and that resend_rate is 10 or more']

    def report_values(self, now: int) -> dict[str, str | float]:
        """Return what the MCU reports, as keys and values of a status; nothing if it does not."""
        report = self._report
        if report is None:
            return {}
        figures = zip(_KEYS, map(str, report[1:]), strict=True)
        return {'MCU version': report.version,
                **dict(figures if report.version == VERSION else ()),
                'MCU report age (s)': f'{(now - self._reported_at) / NS_PER_S:.1f}'}

    def garbage(self, now: int) -> str:
        """Return a complaint about new garbage, '' when there is none or it was just said."""
        new = self.garbage_bytes - self._known_garbage
        if not new or now - self._complained < _GARBAGE_PERIOD:
            return ''
        self._known_garbage = self.garbage_bytes
        self._complained = now
        return f'the MCU sent {new} bytes that are not text; check baud, ground and its firmware'
