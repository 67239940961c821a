# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The tool that tries changes to the core: what it calls noticed, a test has noticed."""

import json
from pathlib import Path
import subprocess
import sys

import pytest

from rigs.mutation import EQUIVALENT
from rigs.mutation import FILES
from rigs.mutation import mutants

ROOT = Path(__file__).parents[1]
CODE = """
LIMIT = 3

def doubled(value):
    return 2 * value

def never_called():
    return 1
"""
TEST = """
from small.code import doubled
from small.code import LIMIT

def test_doubled():
    assert doubled(LIMIT) == 6
"""
# Say of a change to each part of the file whether it is noticed; `judge` is the way it is tried.
CHECK = """
import ast, json, os, sys
from pathlib import Path
from rigs import mutation_worker as tool

def changed(place, code):
    tree = ast.parse(Path('small/code.py').read_text())
    statement = tree.body[place]
    if code:
        new = ast.parse(code).body[0]
        for one in ast.walk(new):
            if hasattr(one, 'lineno'):
                one.lineno = one.end_lineno = statement.lineno
        if place:
            statement.body = [new]
        else:
            tree.body[0] = statement = new
    return tree, statement.body[0] if place else statement

def judge(*change):
    try:
        return worker.notices('small/code.py', *changed(*change))
    except tool.NotJudged as error:
        return f'not judged: {error}'

def work(of_pytest):
    global worker
    worker = of_pytest
    found = {
        'function unchanged': judge(1, ''), 'module unchanged': judge(0, ''),
        'function raises': judge(1, 'raise RuntimeError'), 'module raises': judge(0, '1 / 0'),
        'constant': judge(0, 'LIMIT = 4'), 'not called': judge(2, 'raise RuntimeError')}
    def broken(*_):
        raise LookupError('the tool')
    tool._run_again = broken
    found['tool raises'] = judge(0, '')
    tool._run_again = lambda *_: os._exit(0)
    found['child dies'] = judge(0, '')
    tool.print_now(json.dumps(found))
    return 0

tool.ROOT = Path.cwd()
sys.exit(tool.run(['test/test_small.py'], work))
"""
EXPECTED = {
    'function unchanged': False, 'module unchanged': False, 'function raises': True,
    'module raises': True, 'constant': True, 'not called': False,
    'tool raises': 'not judged: LookupError: the tool', 'child dies': 'not judged: died',
}


@pytest.fixture
def project(tmp_path: Path) -> Path:
    for name, text in (('small/__init__.py', ''), ('small/code.py', CODE),
                       ('test/test_small.py', TEST)):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


def checked(project: Path) -> 'subprocess.CompletedProcess[str]':
    return subprocess.run([sys.executable, '-c', CHECK], cwd=project, text=True, timeout=60,
                          capture_output=True, env={'PYTHONPATH': str(ROOT)}, check=False)


def test_only_a_failure_of_a_test_is_noticed(project: Path) -> None:
    done = checked(project)
    assert json.loads(done.stdout.splitlines()[-1]) == EXPECTED, done.stderr


def test_nothing_is_judged_by_tests_that_cannot_be_read(project: Path) -> None:
    (project / 'test/test_small.py').write_text('import nothing_of_this_name')
    done = checked(project)
    assert (done.stdout, done.returncode) == (
        'test files that cannot be read; mend them first\n', 1), done.stderr


def test_each_change_that_changes_nothing_is_one_of_those_that_can_be_made() -> None:
    lines = {(one.text, one.change) for file in FILES for one in mutants(file)}
    gone = [named for named in EQUIVALENT
            if not any(text.startswith(named[0]) and change.startswith(named[1])
                       for text, change in lines)]
    assert gone == []
