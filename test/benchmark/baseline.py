# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What the doctor says of every simulated case: test/baseline/doctor.tsv, which tests compare.

    scripts/python -m benchmark.baseline [WORD ...]
        play all, or the cases with a WORD in their name; exit code 1 where the file says
        something else
    scripts/python -m benchmark.baseline --write
        bring it up to date, and the other files there

A row has the family, the case, the expected findings, the findings, the seconds until the expected
one came first, and the verdict (rigs/bus/score.py). docs/doctor_results.md explains the families.
"""

from __future__ import annotations

from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
import re
from statistics import median
import sys

from benchmark import confusion
from benchmark import damage
from benchmark.confusion_cases import CASES
from benchmark.confusion_cases import DXL1_CASES
from benchmark.confusion_cases import FEETECH_CASES
from docs.sample import sample
from rigs.bus import score
from rigs.bus.scenes import PLAYED
from rigs.bus.score import SCENES
from rigs.bus.score import spell
from rigs.bus.wrecked import KINDS
from servobus.doctor.finding_log import FindingLog
from servobus.examination import ENOUGH_TRAFFIC_S
from servobus.tools.doctor import explain

FOLDER = Path(__file__).resolve().parents[1] / 'baseline'
DOCTOR = FOLDER / 'doctor.tsv'
VERDICTS = (score.RIGHT, score.VAGUE, score.SILENT, score.WRONG)


def fault_cells(case, result):
    """
    Return expected, told, after, verdict of a fault of fake_bus.

    Right is the one cause, and nothing else.
    """
    is_right = set(result.told) == set(case.told)
    return (spell(case.told), spell(result.told) or score.NOTHING, f'{result.after_s:.1f}',
            score.RIGHT if is_right else score.WRONG)


def field_cells(scene):
    """Return the cells of a case that people had: the screen of dxl_doctor counts."""
    rig = scene.rig(score.SEED)
    log = FindingLog()

    def heard():
        for report, since in score.reports(scene, rig):
            if since is None or since <= ENOUGH_TRAFFIC_S:
                log.add_report(report)
            yield report, since
    result = score.compare(scene, rig, heard(), score.BOOT)
    told = tuple((one.finding.rule, one.finding.device) for one in log.entries())
    return score.cells(result._replace(
        told=told, verdict=score.verdict_of(scene, told, bool(result.false))))


def _faults(cases, has_sides=False):
    def play(case):
        return fault_cells(case, confusion.examine(case, has_sides))
    return {confusion.label(case): partial(play, case) for case in cases}


def _scenes(play, scenes):
    return {scene.name: partial(play, scene) for scene in scenes}


def scene_cells(scene):
    return score.cells(score.judge(scene))


def _damage(seeds):
    return {kind.name: partial(damage.cells, number, seeds) for number, kind in enumerate(KINDS)}


FAMILIES = {
    'Protocol 2.0': _faults(CASES),
    'Protocol 2.0, sides known': _faults(confusion.SIDED, has_sides=True),
    'Feetech': _faults(FEETECH_CASES),
    'Protocol 1.0': _faults(DXL1_CASES),
    'other programs': _scenes(scene_cells, (one for one in SCENES if one.expected)),
    'other programs, healthy': _scenes(scene_cells, (one for one in SCENES if not one.expected)),
    'field cases': _scenes(field_cells, PLAYED),
    'damage': _damage(damage.KNOWN),
    'damage, other seeds': _damage(damage.BLIND),
}


def errors():
    """Return the error texts that dxl_doctor --explain knows, each with its findings."""
    return ''.join(f'{one.text}\t{" ".join(one.findings)}\n' for one in explain.explanations())


TEXTS = {'errors.tsv': errors, 'registers.txt': sample}


def saved():
    """Return the rows of the file."""
    rows = (line.split('\t') for line in DOCTOR.read_text(encoding='utf-8').splitlines())
    return {(family, case): tuple(cells) for family, case, *cells in rows}


def saved_of(family):
    """Return the rows of a family by their case."""
    return {case: cells for (name, case), cells in saved().items() if name == family}


def scores(rows):
    """Return the table of docs/doctor_results.md: the verdicts of each family."""
    return [_score(family, [cells for (name, _), cells in rows.items() if name == family])
            for family in FAMILIES if any(name == family for name, _ in rows)]


def _score(family, rows):
    counts = Counter()
    for *_, verdict in rows:
        for number, word in re.findall(r'(\d*) ?([a-z]+)', verdict):
            counts[word] += int(number or 1)
    after = [float(when) for _, _, when, verdict in rows if when and verdict == score.RIGHT]
    return ' | '.join(('| ' + family, str(counts.total()), *(str(counts[one]) for one in VERDICTS),
                       f'{median(after):.1f} s |' if after else '|'))


def _play(place):
    family, case = place
    return FAMILIES[family][case]()


def main(words):
    """Play cases, print them, and compare them with the file or write them."""
    names = [word for word in words if word != '--write']
    places = [(family, case) for family, cases in FAMILIES.items() for case in cases]
    chosen = [place for place in places
              if not names or any(name in ' '.join(place) for name in names)]
    found = {}
    with ProcessPoolExecutor() as pool:
        for place, cells in zip(chosen, pool.map(_play, chosen), strict=True):
            found[place] = cells
            print(*_lines({place: cells}), flush=True)
    before = saved() if DOCTOR.exists() else {}
    rows = {place: cells for place in places if (cells := found.get(place, before.get(place)))}
    print('', *scores(found), sep='\n')
    changed = [place for place in (*rows, *before) if rows.get(place) != before.get(place)]
    if '--write' in words:
        DOCTOR.write_text(''.join(f'{line}\n' for line in _lines(rows)), encoding='utf-8')
        for name, make in TEXTS.items():
            (FOLDER / name).write_text(make(), encoding='utf-8')
        changed = [place for place in changed
                   if 'wrong' in rows.get(place, ()) and 'wrong' not in before.get(place, ())]
        if changed:
            print('written, and a rule is to be mended; a false alarm is new in:',
                  *map(' '.join, changed), sep='\n  ', file=sys.stderr)
            return 1
    elif changed:
        print(f'{DOCTOR}: not so there, --write brings it up to date:', *map(' '.join, changed),
              sep='\n  ', file=sys.stderr)
        return 1
    return 0


def _lines(rows):
    return ['\t'.join((*place, *cells)) for place, cells in rows.items()]


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
