# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The doctor against two generators of traffic, in simulated time.

    python -m benchmark.confusion            both, to the terminal
    python -m benchmark.confusion --write    both, to docs/doctor_confusion.md, doctor_dialects.md
                                             and doctor_scenes.md

The first is `fake_bus`: every fault against every finding, with Protocol 2.0, Feetech and Protocol
1.0; the monitor hears each burst by itself, which is finer than most adapters tell; that of 2.0
once more as the master's own port has it, with the sides known. The second, `rigs/bus`, shares
nothing with it. One seed: the tables are the same on every machine, and tests hold the files to
them.
"""

from __future__ import annotations

from collections.abc import Iterator
from operator import itemgetter
from pathlib import Path
import sys
from typing import NamedTuple

from benchmark.confusion_cases import Case
from benchmark.confusion_cases import CASES
from benchmark.confusion_cases import DXL1_CASES
from benchmark.confusion_cases import FEETECH_CASES
from benchmark.confusion_cases import Key
from benchmark.confusion_cases import Scene
from dxl_monitor.bus.conversation import Settings
from dxl_monitor.bus.expected import parse_all
from dxl_monitor.bus.report import BusReport
from dxl_monitor.bus.report import Finding
from dxl_monitor.doctor import RULES
from dxl_monitor.fake.fake_bus import make_devices
from dxl_monitor.fake.fake_bus import make_line
from dxl_monitor.fake.faults import parse
from dxl_monitor.fake.line import by_sides
from dxl_monitor.fake.master import Master
from dxl_monitor.fake.traffic import PATTERNS
from dxl_monitor.model.models import Models
from dxl_monitor.monitor import Monitor
from msg_defs.heard import UNKNOWN
from rigs.bus import page

DOCS = Path(__file__).parents[1] / 'docs'
S = 1_000_000_000
SEED = 1
REPORT_NS = S // 2
ONSET_S = 2.0
WITHIN_S = 5.0
MODELS = Models()

class Result(NamedTuple):
    """What was told at the end, and when each of it was told first (s after the fault)."""

    told: tuple[Key, ...]
    after_s: float
    findings: tuple[Finding, ...]


SIDED = tuple(case for case in CASES if case.told != (('wrong_baud', None),))
ONLY_SIDES = (
    'Only the sides tell:', '',
    '- an instruction that never left the adapter (`not_sent`): on the wire there is nothing, and '
    'its', '  answer is not missed;',
    '- an echo from an instruction that the program said twice: each is known by itself;',
    '- one instruction of another master: it came to the program that did not send it;',
    '- an answer after damage: each side is framed by itself, so damage in one direction costs '
    'the other', '  nothing, and an answer that was cut is decided before the next instruction;',
    '- what the kernel dropped: what was not heard is said, and nothing is judged by it.')


def reports(faults: list[str], scene: Scene, seconds: float,
            has_sides: bool = False) -> Iterator[BusReport]:
    """
    Yield the reports of a monitor on a simulated bus, two per second of its time.

    has_sides: it hears the master's own port, as usb: and tap: do.
    """
    devices = make_devices(list(scene.devices), MODELS, scene.baud, dialect=scene.dialect)
    line = make_line(devices, scene.baud, scene.dialect, waits_in_line=scene.waits_in_line)
    master = Master(line, PATTERNS[scene.pattern], rate=scene.rate, seed=SEED,
                    faults=[parse(fault) for fault in faults])
    monitor = Monitor('bus', MODELS, Settings(
        baud=scene.baud, devices=tuple(parse_all(list(scene.devices)))))
    report_at, end = REPORT_NS, round(seconds * S)
    heard = own_port(master, end) if has_sides else chunks(master, end, scene.gather)
    for chunk, stamp, side in heard:
        while stamp > report_at:
            yield monitor.report(report_at)
            report_at += REPORT_NS
        monitor.feed(chunk, stamp, side)
    while report_at <= end:
        yield monitor.report(report_at)
        report_at += REPORT_NS


def own_port(master: Master, end: int) -> list[tuple[bytes, int, str]]:
    """Return what the port of the master writes and reads, in order of time."""
    told = [(stamp, side, data) for burst in master.bursts(end)
            for stamp, side, data in by_sides(burst, master.line.baud)]
    return [(data, stamp, side) for stamp, side, data in sorted(told, key=itemgetter(0))]


def chunks(master: Master, end: int, gather: int) -> Iterator[tuple[bytes, int, str]]:
    """Yield the bursts as an adapter hands them over: each at once, or some time's together."""
    gathered, due = b'', 0
    for burst in master.bursts(end):
        if gathered and burst.end > due:
            yield gathered, due, UNKNOWN
            gathered = b''
        if burst.data and not gather:
            yield burst.data, burst.end, UNKNOWN
        elif burst.data:
            due = due if gathered else (burst.end // gather + 1) * gather
            gathered += burst.data
    if gathered:
        yield gathered, due, UNKNOWN


def told(report: BusReport) -> tuple[Key, ...]:
    """Return what a report claims, without the words."""
    return tuple((finding.rule, finding.device) for finding in report.findings)


def examine(case: Case, has_sides: bool = False) -> Result:
    """Play a fault and see what is told."""
    at = ONSET_S if '{at}' in case.fault else 0.0
    first: dict[Key, float] = {}
    findings: tuple[Finding, ...] = ()
    for report in reports([case.fault.format(at=at)], case.scene, at + WITHIN_S, has_sides):
        findings = report.findings
        for key in told(report):
            first.setdefault(key, report.stamp / S - at)
    return Result(tuple((one.rule, one.device) for one in findings),
                  max((first[key] for key in case.told if key in first), default=-1.0), findings)


def results(cases: tuple[Case, ...]) -> list[tuple[Case, Result]]:
    """Play all cases."""
    return [(case, examine(case)) for case in cases]


def render(results: list[tuple[Case, Result]], sided: list[tuple[Case, Result]]) -> str:
    """Return the page of Protocol 2.0; sided: what is told with the sides known."""
    return '\n'.join([
        '# Faults against findings', '',
        'Made by `python -m benchmark.confusion --write` with `fake_bus` in simulated time; a '
        'test holds', 'this page to it. Each fault of `fake_bus` is played alone, on a robot of '
        'nine devices that walks', 'and speaks Protocol 2.0; Protocol 1.0 and Feetech have '
        '[a page of their own](doctor_dialects.md).', *_table(results),
        '', *_sides(results, sided)]) + '\n'


def render_dialects(feetech: list[tuple[Case, Result]], dxl1: list[tuple[Case, Result]]) -> str:
    """Return the page of the 1.0 family."""
    return '\n'.join([
        '# Faults against findings: Feetech and Protocol 1.0', '',
        'Made by `python -m benchmark.confusion --write` with `fake_bus` in simulated time; a '
        'test holds', 'this page to it. As on [the page of Protocol 2.0](doctor_confusion.md), '
        'each fault is played alone.', '',
        '## Feetech', '',
        '`fake_bus --dialect feetech`: eight STS servos at 1 MBd that move, read by Sync Read and '
        'written', 'by Sync Write.', *_table(feetech), '',
        '## Dynamixel Protocol 1.0', '',
        '`fake_bus --dialect dxl1`: five AX-12A and three MX-28 at 1 MBd that move, read one by '
        'one and', 'written by Sync Write.', *_table(dxl1)]) + '\n'


def _table(results: list[tuple[Case, Result]]) -> list[str]:
    """Return how many are told rightly, what is told of each, and all findings across."""
    names = [rule.name for rule in RULES]
    used = [name for name in names
            if any(name == rule for _, result in results for rule, _ in result.told)]
    numbers = {name: number for number, name in enumerate(used, 1)}
    right = sum(set(result.told) == set(case.told) for case, result in results)
    lines = [
        f'This is what the doctor says {WITHIN_S:.0f} s later: '
        f'{right} of {len(results)} are told as the one cause they are, on the',
        'right device, and nothing else.', '',
        '| fault | told | on | after |', '|---|---|---|---|']
    for case, result in results:
        for rule, device in result.told:
            where = 'bus' if device is None else f'{device:03}'
            lines.append(f'| {_label(case)} | {rule} | {where} | {result.after_s:.1f} s |')
        if not result.told:
            lines.append(f'| {_label(case)} | nothing | | |')
    lines += ['', 'All findings across: `#` the cause, `x` a false one, `.` not told. Not in the '
              'columns because', 'no fault alone makes them told: '
              + ', '.join(name for name in names if name not in used) + '.', '', '```']
    lines += [f'{number:2} {name}' for name, number in numbers.items()]
    width = max(len(_label(case)) for case, _ in results)
    lines += ['', ' ' * width + ' '.join(f'{number:3}'[1:] for number in numbers.values())]
    lines += [_label(case).ljust(width) + ' '.join(
        _mark(name, case, result) for name in used).rstrip() for case, result in results]
    return [*lines, '```']


def _sides(results: list[tuple[Case, Result]], sided: list[tuple[Case, Result]]) -> list[str]:
    """Return the section on the same faults, heard on the master's own port."""
    right = sum(set(result.told) == set(case.told) for case, result in sided)
    without = dict(results)
    lines = [
        '## With the sides known', '',
        "The same faults as the master's own port has them (`usb:`, `tap:`): what it wrote is "
        'whole,', 'also where the wire damaged it, and while it writes it hears nothing. '
        f'{right} of {len(sided)} are told as the',
        'one cause they are, on the right device, and nothing else. `wrong_baud` is not among '
        'them: the rate', 'comes with the source. What is told otherwise, or at another time:', '',
        '| fault | without sides | with sides |', '|---|---|---|']
    lines += [f'| {_label(case)} | {_words(without[case])} | {_words(result)} |'
              for case, result in sided if _words(result) != _words(without[case])]
    return [*lines, '', *ONLY_SIDES]


def _words(result: Result) -> str:
    rules = ', '.join(rule for rule, _ in result.told) or 'nothing'
    return f'{rules} after {result.after_s:.1f} s'


def _label(case: Case) -> str:
    name = case.fault.replace(':{at}', '').removesuffix(':0').rstrip(':')
    return f'{name} ({case.about})' if case.about else name


def _mark(name: str, case: Case, result: Result) -> str:
    if name not in [rule for rule, _ in result.told]:
        return ' .'
    return ' #' if {key for key in result.told if key[0] == name} <= set(case.told) else ' x'


def main() -> int:
    """Write the pages to where they belong, or to the terminal."""
    sided = [(case, examine(case, has_sides=True)) for case in SIDED]
    pages = {'doctor_confusion.md': render(results(CASES), sided),
             'doctor_dialects.md': render_dialects(results(FEETECH_CASES), results(DXL1_CASES)),
             'doctor_scenes.md': page.render(page.results())}
    for name, text in pages.items():
        if sys.argv[1:] == ['--write']:
            (DOCS / name).write_text(text, encoding='utf-8')
        else:
            print(text)
    return 0


if __name__ == '__main__':
    sys.exit(main())
