# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Try mutants in one pytest that has read all tests: it forks for each, and changes no file.

Run by rigs.mutation. Which test calls which function is recorded first, so that a mutant meets
only the tests that can notice it, those that noticed most before in front. A change within a
function is put into the functions that are there; any other needs its modules read again.
"""

import ast
from collections import Counter
from collections.abc import Callable
from collections.abc import Iterator
from collections.abc import Sequence
import gc
from importlib.machinery import SourceFileLoader
import os
from pathlib import Path
import pickle
import select
import signal
import sys
import threading
import time
from types import CodeType
from types import FunctionType
from typing import Any
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[1]
FUNCTIONS = ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda
LEAST_S = 10.0                     # a mutant has so long, and longer where its tests are slow
ENDED = b'+'                       # what a child says first that ran to its end
BROKEN = b'!'                      # and one that did not
SLOWER = 10                        # times as long as the tests took: it does not end


class NotJudged(Exception):
    """The tool itself went wrong, or could not run the tests: that says nothing of a mutant."""


class Recorded(NamedTuple):
    """A test as it is: what it calls, as (file, first line of the function)."""

    name: str
    seconds: float
    calls: frozenset[tuple[str, int]]
    passed: bool


class Worker:
    """A plugin for pytest that runs no test in this process, and does its work instead."""

    def __init__(self, work: Callable[['Worker'], int]) -> None:
        self._work = work
        self.result = 1
        self._kills: Counter[str] = Counter()
        self._items: list[pytest.Item] = []
        self.recorded: list[Recorded] = []

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        self._items = session.items
        if session.testsfailed:                    # each test would seem to fail
            print_now('test files that cannot be read; mend them first')
            return True
        answer = _forked(lambda: _record(session), 3600.0)
        self.recorded = pickle.loads(answer or pickle.dumps([]))
        self.result = self._work(self)
        return True

    def notices(self, file: str, tree: ast.Module, node: ast.AST) -> bool | None:
        """
        Tell whether a test fails with this tree of a file; None if they do not end.

        What is no failure of a test raises NotJudged.
        """
        path = str(ROOT / file)
        function = _innermost(tree, node)
        tests = [one for one in self.recorded if one.passed and (
            (path, function) in one.calls if function else _may_notice(file, one))]
        tests.sort(key=lambda one: (-self._kills[one.name], one.seconds))
        limit = LEAST_S + SLOWER * sum(one.seconds for one in tests)
        code = compile(ast.fix_missing_locations(tree), path, 'exec')
        names = [one.name for one in tests]
        run = self._run_swapped if function else _run_again
        answer = _forked(lambda: run(names, path, code), limit)
        if answer is None:
            return None
        self._kills[answer.decode()] += 1
        return bool(answer)

    def _run_swapped(self, names: list[str], path: str, code: CodeType) -> bytes:
        """Run tests with other code in the functions of a file; return which one failed."""
        new = {(one.co_name, one.co_firstlineno): one for one in _codes(code)}
        for one in gc.get_objects():
            if isinstance(one, FunctionType) and one.__code__.co_filename == path:
                key = one.__code__.co_name, one.__code__.co_firstlineno
                if key in new and one.__code__ != new[key]:
                    try:
                        one.__code__ = new[key]
                    except ValueError:             # it needs other variables around it
                        return _run_again(names, path, code)
        by_name = {item.nodeid: item for item in self._items}
        items = [by_name[name] for name in names]
        for item, following in zip(items, [*items[1:], None], strict=False):
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            if item.session.testsfailed:
                return item.nodeid.encode()
        return b''


def _record(session: pytest.Session) -> bytes:
    """Run all tests; return what each of them calls."""
    calls: set[tuple[str, int]] = set()
    root = str(ROOT)

    def note(frame: Any, event: str, argument: object) -> None:
        if event == 'call' and frame.f_code.co_filename.startswith(root):
            calls.add((frame.f_code.co_filename, frame.f_code.co_firstlineno))

    recorded = []
    threading.setprofile(note)
    for item, following in zip(session.items, [*session.items[1:], None], strict=True):
        calls.clear()
        failed, began = session.testsfailed, time.perf_counter()
        sys.setprofile(note)
        item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
        sys.setprofile(None)
        recorded.append(Recorded(item.nodeid, time.perf_counter() - began, frozenset(calls),
                                 session.testsfailed == failed))
    return pickle.dumps(recorded)


def _run_again(names: list[str], path: str, code: CodeType) -> bytes:
    """Read all modules again, one of them changed; return which test failed, if any."""
    for name, module in list(sys.modules.items()):
        if str(getattr(module, '__file__', '') or '').startswith(str(ROOT)) \
                and '.venv' not in module.__file__ and not name.startswith('rigs.mutation'):
            del sys.modules[name]
    usual = SourceFileLoader.get_code
    SourceFileLoader.get_code = lambda self, name: \
        code if self.path == path else usual(self, name)
    order = {name: place for place, name in enumerate(names)}
    chosen = Chosen(order)
    files = sorted({name.partition('::')[0] for name in names})
    result = pytest.main([*OPTIONS, '-x', *files], plugins=[chosen]) if names else 0
    if not chosen.failed and (result or chosen.missing):
        raise NotJudged(f'pytest ended with {int(result)}, {chosen.missing} tests were not there')
    return chosen.failed.encode()


class Chosen:
    """A plugin for pytest: only these tests, in this order."""

    def __init__(self, order: dict[str, int]) -> None:
        self._order = order
        self.failed = ''
        self.missing = 0           # a change can rename tests

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = sorted((one for one in items if one.nodeid in self._order),
                          key=lambda one: self._order[one.nodeid])
        self.missing = len(self._order) - len(items)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self.failed = report.nodeid

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        """Note a test file that cannot be read, as with a module that raises."""
        if report.failed:
            self.failed = report.nodeid


# Only what is quick: without ROS, and of the fuzz tests the machines and the kept inputs.
OPTIONS = ('-q', '-p', 'no:cacheprovider', '-m', 'not ros and not slow and not alone',
           '-k', 'not any_input and not volume and not fuzzer_says')


def _may_notice(file: str, test: Recorded) -> bool:
    return any(path == str(ROOT / file) or path in _importers(file) for path, _ in test.calls)


_IMPORTERS: dict[str, frozenset[str]] = {}


def _importers(file: str) -> frozenset[str]:
    """Return the files that import this one by name, tests too: constants call nothing."""
    if file not in _IMPORTERS:
        module = file.removesuffix('.py').removesuffix('/__init__').replace('/', '.')
        package, _, name = module.rpartition('.')
        said = f'from {module} import', f'from {package} import {name}\n', f'import {module}\n'
        _IMPORTERS[file] = frozenset(
            str(path) for package in ('msg_defs', 'dxl_monitor', 'vel2d_bridge', 'test')
            for path in (ROOT / package).rglob('*.py')
            if any(one in path.read_text() for one in said))
    return _IMPORTERS[file]


def _innermost(tree: ast.Module, node: ast.AST) -> int:
    """Return the first line of the function whose body a node is in, 0 if in none."""
    found = 0
    for one in ast.walk(tree):
        if isinstance(one, FUNCTIONS):
            body = [one.body] if isinstance(one, ast.Lambda) else one.body
            if any(part is node for statement in body for part in ast.walk(statement)):
                lines = [one.lineno, *(by.lineno for by in getattr(one, 'decorator_list', ()))]
                found = max(found, min(lines))
    return found


def _codes(code: CodeType) -> Iterator[CodeType]:
    for one in code.co_consts:
        if isinstance(one, CodeType):
            yield one
            yield from _codes(one)


def _forked(run: Callable[[], bytes], limit_s: float) -> bytes | None:
    """
    Return what a function returns in a child of its own; None if it takes too long.

    Where it raises there, or the child dies, NotJudged says so.
    """
    reading, writing = os.pipe()
    child = os.fork()
    if not child:
        os.setsid()
        try:
            answer = ENDED + run()
        except BaseException as error:
            answer = BROKEN + f'{type(error).__name__}: {error}'.encode()
        with open(writing, 'wb') as pipe:
            pipe.write(answer)
        os._exit(0)
    os.close(writing)
    until = time.monotonic() + limit_s
    answer = b''
    with open(reading, 'rb', buffering=0) as pipe:
        while True:
            ready, _, _ = select.select([pipe], [], [], max(0.0, until - time.monotonic()))
            part = pipe.read(1 << 16) if ready else None
            if not part:
                break
            answer += part
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    if part is None:
        return None
    if not answer.startswith(ENDED):
        raise NotJudged(answer.removeprefix(BROKEN).decode() or 'died')
    return answer.removeprefix(ENDED)


def print_now(line: str) -> None:
    """Print past pytest, which keeps what is printed to itself."""
    os.write(_output, f'{line}\n'.encode())


def run(tests: Sequence[str], work: Callable[[Worker], int]) -> int:
    """Read these test files, record them, and do the work; return what it returns."""
    worker = Worker(work)
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 1)
    pytest.main([*OPTIONS, *tests], plugins=[worker])
    return worker.result


_output = os.dup(1)
