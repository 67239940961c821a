# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Mutation: which changes to the core do its tests not notice? (python -m rigs.mutation).

Every mutant is one small change to one of FILES: an operator, a constant, a condition, a call
left out. A sample of them, seeded, is tried one by one in memory against the tests of FILES, of
them only those that call the changed function (mutation_worker.py). What passes has survived: a
hole in the tests, or a change that changes nothing (then it is named in EQUIVALENT, with the
reason). --unchanged checks the tool: without the changes, nothing may be noticed.
"""

import argparse
import ast
from collections import Counter
from collections.abc import Callable
from collections.abc import Iterator
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
import random
import sys
from typing import Any
from typing import NamedTuple

from rigs.mutation_worker import NotJudged
from rigs.mutation_worker import print_now
from rigs.mutation_worker import ROOT
from rigs.mutation_worker import run
from rigs.mutation_worker import Worker

_BUS = ('test_bus_edges.py', 'test_tracker.py', 'test_monitor.py', 'test_table.py',
        'test_dxl1_classifier.py', 'test_sides.py', 'test_expected.py')
_DOCTOR = ('test_doctor_evidence.py', 'test_doctor_edges.py', 'test_doctor_time.py',
           'test_doctor_standing.py', 'test_doctor.py', 'test_doctor_feetech.py', 'test_bits.py',
           'test_two_timers.py')
FILES = {
    'msg_defs/crc.py': ('test_vel2d.py', 'test_dxl_packet.py', 'test_dxl_instruction.py'),
    'msg_defs/dxl_packet.py': ('test_dxl_packet.py', 'test_tracker.py', 'test_fuzz.py'),
    **{f'dxl_monitor/bus/{name}.py': _BUS for name in (
        'decoder', 'device', 'dialect', 'dxl1_classifier', 'evidence', 'expected',
        'id_confirmation', 'pairing', 'plan', 'planner', 'registry', 'reply_policy', 'report',
        'table', 'tracker')},
    **{f'dxl_monitor/doctor/{name}.py': _DOCTOR for name in (
        '__init__', 'bits', 'case', 'collision', 'configuration', 'damage', 'feetech', 'health',
        'presence', 'rate', 'rhythm', 'rule', 'setting_up', 'states', 'timing_rules',
        'two_timers')},
    'vel2d_bridge/gate.py': ('test_gate.py', 'test_bridge_safety.py'),
    'vel2d_bridge/pacer.py': ('test_pacer.py', 'test_bridge_safety.py', 'test_link.py'),
}

# Mutants that change nothing that anybody could see: how their line and their change begin.
_NS = 'a ns more or less than never'
_NOT_READ = 'written before it is read'
_LONG_WAY = 'the long way says the same'
_NO_FIELDS = 'None and () are both no fields'
EQUIVALENT = {
    ('self._hold_until = 0', '0 -> 1'): _NS,
    ('self._refuse_until = 0', '0 -> 1'): _NS,
    ('self._slot_begins_at = 0', '0 -> 1'): _NS,
    ('waited: int = 0', '0 -> 1'): _NS,
    ('self, velocity: Vel2d, now: int, *, waited: int = 0', '0 -> 1'): _NS,
    ('(0 < self._timeout < waited', '0 -> 1'): _NS,
    ('(stamp_age is not None and 0 < oldest', '0 -> 1'): _NS,
    ('self._asked = self._pause = 0', '0 -> 1'): _NS,
    ('self._rhythms: tuple[int, list[Rhythm]] = (0', '0 -> 1'): _NS,
    ('NEVER = 2**63 - 1', ''): 'later than anything, in any spelling',
    ('self._resend = max(', '0 -> 1 in column 89'): 'a resend_rate is 0 or at least 2',
    ('self._burst_zeros_left = 0', '0 -> 1'): _NOT_READ,
    ('self.time_outs_in_row = 0   ', '0 -> 1'): _NOT_READ,
    ('self._frame_is_late = False   ', 'False -> True'): _NOT_READ,
    ('self._frame_under_way = False   ', 'False -> True'): _NOT_READ,
    ('self._lowered_not_sent = False   ', 'False -> True'): 'the stops of the opening clear it',
    ('self._wanted = 0   ', '0 -> 1'): _NOT_READ,
    ('self._last_turn_at = 0', '0 -> 1'): _NOT_READ,
    ('self._last_written_at = 0', '0 -> 1'): _NOT_READ,
    ('self._turn_before_freeze = -1', '1 -> 2'): 'no turn was at either time',
    ('self._asked = (0, 0, 0)', '0 -> 1'): _NOT_READ,
    ('self._unresolved = False               # no status', 'False -> True'): _NOT_READ,
    ('self._combined(wire + body_crc(wire).to_bytes(2', '2 -> 3'): 'a byte behind all blocks',
    ('mark = find(_TAIL, mark + 1)', '1 -> 2'): 'FF FD 00 does not overlap itself',
    ('self._wanted = wanted - (size', 'Sub -> Add in column 33'): 'looks earlier, in vain',
    ('self.is_unusual = True', 'True -> False in column 19'): _LONG_WAY,
    ('if fields[1::4] != self._ids', '1 -> 2'): _LONG_WAY,
    ('if fields[1::4] != self._ids', '4 -> 5'): _LONG_WAY,
    ('return ()', 'return None'): _NO_FIELDS,
    ('@lru_cache(maxsize=', ''): 'what is forgotten is worked out again',
    ('while at < len(noise)', 'Lt -> LtE'): 'behind the end there is nothing to find',
    ('while 0 <= at < len(noise) - 4', 'Lt -> LtE'): 'four bytes are too few for an answer',
}

COMPARE: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}
BINARY: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.FloorDiv, ast.FloorDiv: ast.Mult,
    ast.Div: ast.Mult, ast.BitOr: ast.BitAnd, ast.BitAnd: ast.BitOr, ast.LShift: ast.RShift,
    ast.RShift: ast.LShift, ast.Mod: ast.Mult,
}


# What a change is, and what does it to a node.
Change = tuple[str, Callable[[Any], object]]


class Mutant(NamedTuple):
    """One change: the line it is in, what it is, where in the tree of its file it is."""

    file: str
    line: int
    text: str
    change: str
    node: int                      # in the order of ast.walk
    number: int                    # among the changes of the node

    def __str__(self) -> str:
        return f'{self.file}:{self.line}: {self.change}: {self.text}'

    @property
    def changes_nothing(self) -> bool:
        return any(self.text.startswith(line) and self.change.startswith(change)
                   for line, change in EQUIVALENT)

    def tree(self, *, unchanged: bool = False) -> tuple[ast.Module, ast.AST]:
        """Return the whole file with the change or without, and the node that is changed."""
        tree = ast.parse((ROOT / self.file).read_text())
        node = list(ast.walk(tree))[self.node]
        _, apply = list(_changes(node))[self.number]
        if not unchanged:
            apply(node)
        return tree, node


def mutants(file: str) -> Iterator[Mutant]:
    """Yield every mutant of a file; docstrings, types and imports are left alone."""
    source = (ROOT / file).read_text()
    lines = source.splitlines()
    tree = ast.parse(source)
    left_alone = {id(one.value) for one in ast.walk(tree)
                  if isinstance(one, ast.keyword) and one.arg == 'strict'}
    for index, node in enumerate(ast.walk(tree)):
        if id(node) in left_alone:
            continue
        for number, (what, _) in enumerate(_changes(node)):
            line = getattr(node, 'lineno', 1)
            yield Mutant(file, line, lines[line - 1].strip(),
                         f'{what} in column {getattr(node, "col_offset", 0)}', index, number)


def _changes(node: ast.AST) -> Iterator[Change]:
    changes = _CHANGES.get(type(node))
    return changes(node) if changes is not None else iter(())


def _compare(node: ast.Compare) -> Iterator[Change]:
    for at, operator in enumerate(node.ops):
        other = COMPARE[type(operator)]
        yield (f'{type(operator).__name__} -> {other.__name__}',
               lambda one, at=at, other=other: one.ops.__setitem__(at, other()))


def _binary(node: ast.BinOp | ast.AugAssign) -> Iterator[Change]:
    other = BINARY.get(type(node.op))
    if other is not None and not _is_text(node) and not _is_type(node):
        yield (f'{type(node.op).__name__} -> {other.__name__}',
               lambda one: setattr(one, 'op', other()))


def _boolean(node: ast.BoolOp) -> Iterator[Change]:
    other = ast.Or if isinstance(node.op, ast.And) else ast.And
    yield (f'{type(node.op).__name__} -> {other.__name__}',
           lambda one: setattr(one, 'op', other()))


def _unary(node: ast.UnaryOp) -> Iterator[Change]:
    if isinstance(node.op, ast.Not):
        yield 'without not', _without_not


def _without_not(node: ast.UnaryOp) -> None:
    node.op = ast.UAdd()
    node.operand = ast.Call(ast.Name('bool', ast.Load()), [node.operand], [])


def _constant(node: ast.Constant) -> Iterator[Change]:
    if isinstance(node.value, bool):
        yield f'{node.value} -> {not node.value}', lambda one: setattr(
            one, 'value', not one.value)
    elif isinstance(node.value, int | float):
        yield f'{node.value} -> {node.value + 1}', lambda one: setattr(
            one, 'value', one.value + 1)


def _expression(node: ast.Expr) -> Iterator[Change]:
    if isinstance(node.value, ast.Call):
        yield 'call left out', lambda one: setattr(one, 'value', ast.Constant(None))


def _condition(node: ast.If | ast.While | ast.IfExp) -> Iterator[Change]:
    yield 'never', lambda one: setattr(one, 'test', ast.Constant(False))


def _call(node: ast.Call) -> Iterator[Change]:
    other = {'min': 'max', 'max': 'min'}.get(getattr(node.func, 'id', ''))
    if other is not None:
        yield f'-> {other}', lambda one: setattr(one.func, 'id', other)


def _return(node: ast.Return) -> Iterator[Change]:
    if node.value is not None and getattr(node.value, 'value', True):       # not False or None
        yield 'return None', lambda one: setattr(one, 'value', ast.Constant(None))


_CHANGES: dict[type[ast.AST], Callable[..., Iterator[Change]]] = {
    ast.Compare: _compare, ast.BinOp: _binary, ast.AugAssign: _binary, ast.BoolOp: _boolean,
    ast.UnaryOp: _unary, ast.Constant: _constant, ast.Expr: _expression, ast.If: _condition,
    ast.While: _condition, ast.IfExp: _condition, ast.Call: _call, ast.Return: _return,
}


def _is_text(node: ast.AST) -> bool:
    return any(isinstance(one, ast.Constant) and isinstance(one.value, str | bytes)
               for one in ast.walk(node))


def _is_type(node: ast.AST) -> bool:
    """Tell whether this is `X | None`: a type."""
    return isinstance(node, ast.BinOp) and isinstance(node.op, ast.BitOr) and any(
        isinstance(one, ast.Constant) and one.value is None for one in (node.left, node.right))


def sample(count: int, seed: int, files: Sequence[str]) -> list[Mutant]:
    """
    Draw from all mutants of these files, each as likely as any other.

    A line that is added or changed leaves those of the other lines in the sample or out of it.
    """
    alike: Counter[tuple[str, str, str]] = Counter()

    def lot(one: Mutant) -> float:
        what = one.file, one.text, one.change
        alike[what] += 1
        return random.Random(f'{seed} {what} {alike[what]}').random()

    drawn = {one: lot(one) for file in files for one in mutants(file)}
    chosen = sorted(drawn, key=drawn.__getitem__)[:count]
    return sorted(chosen, key=lambda one: (one.file, one.line, one.change))


def main() -> int:
    options = _parser().parse_args()
    files = [file for file in FILES if file.startswith(tuple(options.file or ['']))]
    chosen = sample(options.count, options.seed, files)
    tests = sorted({f'test/{name}' for one in chosen for name in FILES[one.file]})
    return run(tests, lambda worker: _judge(worker, chosen, options))


def _judge(worker: Worker, chosen: list[Mutant], options: argparse.Namespace) -> int:
    failing = [one.name for one in worker.recorded if not one.passed]
    if failing or not worker.recorded:
        print_now(f'{", ".join(failing) or "no tests"}: fails as it is; mend it first')
        return 1
    global _worker
    _worker = worker                       # for the processes that are forked here
    with ProcessPoolExecutor(options.jobs, get_context('fork')) as pool:
        found = list(pool.map(_try, chosen, [options.unchanged] * len(chosen)))
    judged = [is_noticed for mutant, is_noticed in zip(chosen, found, strict=True)
              if is_noticed is not None and (options.unchanged or not mutant.changes_nothing)]
    share = 100 * sum(judged) / len(judged) if judged else 0.0
    print_now(f'{sum(judged)} of {len(judged)} mutants noticed: {share:.1f} % '
              f'({found.count(None)} not judged, {len(found) - found.count(None) - len(judged)} '
              f'more change nothing; seed {options.seed})')
    return int(None in found or (options.unchanged and any(judged)))


_worker: Worker


def _try(mutant: Mutant, unchanged: bool) -> bool | None:
    """Return whether a mutant is noticed, None if not judged; say at once what needs a look."""
    try:
        is_noticed = _worker.notices(mutant.file, *mutant.tree(unchanged=unchanged))
    except NotJudged as error:
        print_now(f'not judged ({error}): {mutant}')
        return None
    if is_noticed is None:
        print_now(f'noticed, as its tests do not end: {mutant}')
    elif unchanged:
        if is_noticed:
            print_now(f'noticed without its change: {mutant}')
    elif not is_noticed:
        print_now(f'{"changes nothing" if mutant.changes_nothing else "survived"}: {mutant}')
    elif mutant.changes_nothing:
        print_now(f'noticed, which it cannot be: {mutant}')
    return is_noticed is not False


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog='python -m rigs.mutation', description=(
        'Change the core in small ways and see whether its tests notice.'))
    add = parser.add_argument
    add('--count', type=int, default=300, help='size of the sample (default %(default)s)')
    add('--seed', type=int, default=1, help='of the sample (default %(default)s)')
    add('--jobs', type=int, default=1, help='at the same time (default %(default)s)')
    add('--unchanged', action='store_true', help='check the tool: leave each change out')
    add('--file', metavar='PATH', action='append',
        help='only files that begin so, as dxl_monitor/bus/ (repeatable)')
    return parser


if __name__ == '__main__':
    sys.exit(main())
