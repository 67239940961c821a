# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Plants the faults of rigs/planted.yaml in a copy, one after the other, and runs the tests there.

    scripts/python -m rigs.planted                  all of them
    scripts/python -m rigs.planted --only freeze    those with that word in the name
    scripts/python -m rigs.stutter load -- scripts/python -m rigs.planted
        on a machine that stutters

Exit code: how many were not found. The tests must pass in a copy without a fault, or what they
find says nothing: that is tried first, for all tests together.
"""
import argparse
import os
from pathlib import Path
import shutil
import subprocess
import sys
import tempfile

import yaml

from rigs.harness import REPOSITORY

LIST = Path(__file__).with_name('planted.yaml')
LEFT_OUT = shutil.ignore_patterns('.*', '__pycache__', 'build', 'install', 'log')
LIMIT_S = 300                   # for the tests of one fault; without an end it is found too


def passes(folder, tests):
    """Run tests in a copy; return whether they all pass, and the last lines of what they say."""
    try:
        done = subprocess.run(
            [sys.executable, '-m', 'pytest', '-q', '-x', '-p', 'no:cacheprovider', *tests],
            cwd=folder, text=True, capture_output=True, timeout=LIMIT_S, check=False,
            env={**os.environ, 'PYTHONPATH': str(folder)})
    except subprocess.TimeoutExpired:
        return False, 'no end'
    if done.returncode not in (0, 1):
        raise SystemExit(f'planted: {" ".join(tests)}: {done.stdout}{done.stderr}')
    return done.returncode == 0, ' | '.join(
        line for line in done.stdout.splitlines() if line.startswith(('FAILED', 'ERROR', 'test/')))


def plant(fault, file):
    """Put a fault into a file of the copy; return what was there."""
    text = file.read_text()
    file.write_text(text.replace(fault['old'], fault['new']))
    return text


def faults():
    """Return the list; each text that a fault replaces must be in its file once."""
    listed = yaml.safe_load(LIST.read_text())
    for one in listed:
        count = (REPOSITORY / one['file']).read_text().count(one['old'])
        if count != 1:
            raise SystemExit(f"planted: {one['name']}: {one['file']} has its text {count} times; "
                             'bring rigs/planted.yaml up to date')
    return listed


def main():
    """Plant, run, report."""
    parser = argparse.ArgumentParser(usage=__doc__)
    parser.add_argument('--only', default='', metavar='WORD')
    options = parser.parse_args()
    planted = [one for one in faults() if options.only in one['name']]
    missed = 0
    with tempfile.TemporaryDirectory(prefix='planted_') as place:
        folder = Path(place) / 'copy'
        shutil.copytree(REPOSITORY, folder, ignore=LEFT_OUT)
        for fault in planted:
            well, said = passes(folder, fault['tests'])
            if not well:
                raise SystemExit(f'planted: fail without a fault: {said}')
        for fault in planted:
            file = folder / fault['file']
            sound = plant(fault, file)
            well, said = passes(folder, fault['tests'])
            file.write_text(sound)
            missed += well
            print(f"{'NOT FOUND' if well else 'found'}: {fault['name']}: {said}", flush=True)
    print(f'planted: {len(planted) - missed} of {len(planted)} found')
    return missed


if __name__ == '__main__':
    raise SystemExit(main())
