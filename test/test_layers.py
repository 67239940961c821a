# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The house rules that a machine can hold: import layers, where ROS may be, sizes, names.

Each rule is one test over all files, which lists every place that breaks it.
"""
import ast
from collections import defaultdict
import io
import os
from pathlib import Path
import re
import statistics
import tokenize

from rigs.packages import imported
from rigs.packages import imports
from rigs.packages import LAYERS
from rigs.packages import modules
from rigs.packages import parsed
from rigs.packages import ROOT
import servobus

# Rooms of servobus: its folders, and what its other modules are.
BASE = ('errors', 'printable_text', 'internal_fault', 'worker')
CORE = ('monitor', 'bus_statistics', 'joints', 'signals', 'status')
ROOMS = {                               # room of servobus: which others it may import
    'base': set(),
    'model': {'base'},
    'port': {'base'},
    'bus': {'base', 'model'},
    'doctor': {'base', 'model', 'bus'},
    'core': {'base', 'model', 'bus', 'doctor'},
    'sources': {'base', 'bus', 'port'},
    '': {'base', 'model', 'bus', 'doctor', 'core', 'port', 'sources'},
    'tools': {'base', 'model', 'bus', 'doctor', 'core', 'port', 'sources', ''},
}
BRIDGE_USES = {'base', 'port'}          # of servobus: it drives, and knows no servos
OTHERS_USE = ROOMS.keys() - {'bus', 'doctor'}       # but for the modules of public names
PUBLIC = {'servobus.doctor', *(getattr(servobus, name).__module__ for name in servobus.__all__)}
ROS = ('rclpy', 'rcl_interfaces', 'launch', 'launch_ros', 'ament_index_python', 'std_srvs',
       'builtin_interfaces')
PURE = ('msg_defs', 'servobus/bus', 'servobus/doctor')      # no IO, no clock
IO = {'os', 'socket', 'select', 'time', 'serial', 'subprocess', 'pathlib'}
FILES = [path for package in LAYERS for path in sorted((ROOT / package).rglob('*.py'))]


def is_ros(module):
    top = module.partition('.')[0]
    return top in ROS or top.endswith('_msgs')


def may_use_ros(path):
    return path.name.endswith(('_node.py', '_subscriber.py')) or path in (
        ROOT / 'msg_defs/ros.py', ROOT / 'mecarover_serial/launch.py')


def import_faults(path):
    """Yield what is wrong with the imports of a file."""
    package = path.relative_to(ROOT).parts[0]
    for module in imports(path):
        top = module.partition('.')[0]
        if top in LAYERS and top not in LAYERS[package]:
            yield f'{package} imports {module}'
        if is_ros(module) and not may_use_ros(path):
            yield f'{path.name} imports {module}'
        if module == 'mecarover_serial.launch':
            yield f'{path.name}: only launch files have launch'
        if str(path.relative_to(ROOT)).startswith(PURE) and path.name != 'ros.py' and top in IO:
            yield f'{path.name} does IO or looks at a clock: {module}'


def test_imports_go_downward():
    assert [fault for path in FILES for fault in import_faults(path)] == []


def test_benchmarks_use_the_rigs_and_no_rig_a_benchmark():
    assert [path.name for path in (ROOT / 'test/rigs').rglob('*.py')
            if any(module.startswith('benchmark') for module in imports(path))] == []


def circle_in(arrows):
    """Return a circle in {module: [modules that it imports]}, [] where there is none."""
    done, way = set(), []

    def visit(name):
        if name in way:
            return [*way[way.index(name):], name]
        if name in done:
            return []
        way.append(name)
        found = next(filter(None, map(visit, arrows.get(name, ()))), [])
        way.pop()
        done.add(name)
        return found
    return next(filter(None, map(visit, arrows)), [])


def test_imports_make_no_circle():
    known = modules()
    assert circle_in({name: imported(path, known) for name, path in known.items()}) == []


def room_of(parts):
    """Return the room of a module of servobus, from the parts of its name."""
    if len(parts) < 2:
        return ''
    return parts[1] if parts[1] in ROOMS else 'base' if parts[1] in BASE \
        else 'core' if parts[1] in CORE else ''


def rooms_for(module):
    """Return which rooms of servobus a module may import, from the parts of its name."""
    if module[0] == 'servobus':
        return {*ROOMS[room_of(module)], room_of(module)}
    return BRIDGE_USES if module[0] == 'vel2d_bridge' else \
        OTHERS_USE if module[0] in LAYERS else ROOMS


def test_arrows_between_rooms_go_downward():
    wrong = []
    for name, path in modules().items():
        allowed = rooms_for(name.split('.'))
        public = PUBLIC if allowed is OTHERS_USE else ()
        wrong += [f'{name} imports {module}' for module in imports(path, modules())
                  if module.partition('.')[0] == 'servobus' and module not in public
                  and room_of(module.split('.')) not in allowed]
    assert wrong == []


def test_no_package_imports_private_names_of_another():
    wrong = []
    for path in FILES:
        others = tuple(f'{one}.' for one in LAYERS.keys() - {path.relative_to(ROOT).parts[0]})
        wrong += [f'{path} imports {node.module}.{one.name}' for node in ast.walk(parsed(path))
                  if isinstance(node, ast.ImportFrom) and f'{node.module}.'.startswith(others)
                  for one in node.names if '._' in f'{node.module}.{one.name}']
    assert wrong == []


def test_no_class_name_stands_for_two_things():
    places = defaultdict(list)
    for path in FILES:
        for node in ast.walk(parsed(path)):
            if isinstance(node, ast.ClassDef):
                places[node.name.lstrip('_')].append(f'{path.relative_to(ROOT)}:{node.lineno}')
    assert {name: found for name, found in places.items() if len(found) > 1} == {}


def functions():
    for path in FILES:
        for node in ast.walk(parsed(path)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                yield f'{path.relative_to(ROOT)}:{node.name}', code_lines(node)


def code_lines(function):
    """Lines of a function without its docstring, as style guides count them."""
    first = function.body[0]
    lines = function.end_lineno - function.lineno + 1
    if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
        lines -= first.end_lineno - first.lineno + 1
    return lines


def test_functions_are_short():
    sizes = dict(functions())
    assert [name for name, lines in sizes.items() if lines > 60] == []
    assert statistics.median(sizes.values()) <= 8


def test_every_file_says_what_it_owns():
    assert [path.name for path in FILES if not ast.get_docstring(parsed(path))] == []


FILE_NAME = re.compile(r'(?<![\w/.~*{-])[\w./-]*\w\.(?:py|md|ya?ml|js|css|html|xml|toml|svg)\b')
TEXT = {'.py', '.md', '.yaml', '.yml', '.js', '.css', '.html', '.c', '.service', '.xml', '.toml',
        '.rst', '.rules', ''}            # programs of scripts/ have no suffix
MADE_LATER = {'FILE.svg'}               # a name that stands for what the user chooses


def words_of(path):
    """Yield the docstrings of a program, and its comments if one may name a file."""
    source = path.read_text()
    if any('#' in line and FILE_NAME.search(line) for line in source.splitlines()):
        for token in tokenize.generate_tokens(io.StringIO(source).readline):
            if token.type == tokenize.COMMENT:
                yield token.string
    for node in ast.walk(parsed(path)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield ast.get_docstring(node) or ''


# Words that readers from other countries look up, or read twice; and one form for each unit.
UNUSUAL = re.compile(r'\b(nobody|anew|who(so)?ever|what(so)?ever|elders?|thereof|wherein|degC)\b',
                     re.I)
HALF_SENTENCE = re.compile(r'(\S\s+(#|//)|/\*)\s+of\s')      # of the code in front of it


def our_files():
    for folder, folders, names in os.walk(ROOT):
        folders[:] = [one for one in folders if not one.startswith('.') and one != 'build']
        yield from (Path(folder, name).relative_to(ROOT) for name in names)


def test_words_are_the_usual_ones():
    ours = [name for name in our_files() if name.parts[:2] != ('test', 'corpus')
            and name.suffix in TEXT and name.name not in (Path(__file__).name, 'LICENSE')]
    wrong = [f'{name}:{at}: {line.strip()}' for name in ours
             for at, line in enumerate((ROOT / name).read_text().splitlines(), 1)
             if UNUSUAL.search(line) or (name.suffix != '.md' and HALF_SENTENCE.search(line))]
    assert wrong == []


def names_in(path):
    """Return what a module defines or imports, at any depth."""
    return {found for node in ast.walk(parsed(path)) for found in (
        getattr(node, 'name', None), getattr(node, 'attr', None), getattr(node, 'id', None))}


def test_every_module_that_a_comment_names_exists():
    known = modules()
    dotted = re.compile(rf"\b(?:{'|'.join({name.split('.')[0] for name in known} - {'docs'})})"
                        r"(?:\.[a-z_]\w*)+\b(?!\()")
    missing = []
    for name, path in known.items():
        for words in words_of(path):
            for found in dotted.findall(words):
                module, _, last = found.rpartition('.')
                is_known = found in known or (
                    module in known and last in names_in(known[module]))
                if not is_known and not found.endswith(
                        ('.py', '.md', '.yaml', '.c', '.txt', '.tsv')):
                    missing.append(f'{name}: {found}')
    assert missing == []


def test_every_file_that_a_comment_names_exists():
    listed = [name.as_posix() for name in our_files()]
    known = {name[at:] for name in listed
             for at in (0, *(slash.end() for slash in re.finditer('/', name)))} | MADE_LATER
    missing = [f'{name}: {file}' for name in listed if name.endswith('.py')
               for words in words_of(ROOT / name)
               for file in FILE_NAME.findall(words) if file not in known]
    assert missing == []
