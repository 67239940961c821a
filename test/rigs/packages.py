# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Which package may import which, and the tests of one package where the others are not.

    scripts/test --package servobus     in a copy of the code and a Python without all the others

A test belongs to the lowest package that may import all that the test names: in imports, and as
the module of a process; itself, or in equipment that it uses. The fakes are equipment, too, but
a test that has the name of one of their modules is theirs.
"""
import ast
from functools import cache
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import venv

from rigs.source import copy_source

ROOT = Path(__file__).parents[2]
LAYERS = {                              # package: what of ours it may import
    'msg_defs': {'msg_defs'},
    'servobus': {'msg_defs', 'servobus'},
    'mecarover_serial': {'msg_defs', 'servobus', 'mecarover_serial'},
    'vel2d_bridge': {'msg_defs', 'servobus', 'mecarover_serial', 'vel2d_bridge'},
    'dxl_monitor': {'msg_defs', 'servobus', 'mecarover_serial', 'dxl_monitor'},
    'mecarover_dashboard': {'msg_defs', 'servobus', 'mecarover_serial', 'mecarover_dashboard'},
    'mecarover_fakes': {'msg_defs', 'servobus', 'mecarover_serial', 'mecarover_dashboard',
                        'mecarover_fakes'},
}
FAKES = 'mecarover_fakes'
# Besides equipment these name what a test needs. conftest.py does not: it is for all tests.
NAMES_OTHERS = (FAKES, 'mecarover_serial.command')
PRESENT = """
from importlib.util import find_spec
import sys
sys.exit(', '.join(f'{one}: here too' for one in sys.argv[1:] if find_spec(one)) or 0)
"""
DOTTED = re.compile(r'\b[a-z]\w*(?:\.\w+)+')


@cache
def parsed(path):
    return ast.parse(path.read_text())


def imports(path, known=()):
    """Yield what a file imports; `from a import b` is a.b if that is a known module."""
    for node in ast.walk(parsed(path)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f'{path}: relative import'
            yield from {full if (full := f'{node.module}.{alias.name}') in known else node.module
                        for alias in node.names}


def modules():
    """Return the file of each module of ours, equipment among it, by its name in imports."""
    return {'.'.join(path.relative_to(place).with_suffix('').parts).removesuffix('.__init__'): path
            for place, folders in ((ROOT, (*LAYERS, 'docs')),
                                   (ROOT / 'test', ('benchmark', 'rigs', 'fuzz')))
            for folder in folders for path in (place / folder).rglob('*.py')}


def imported(path, known):
    """Return which of the known modules a file imports, wherever in it."""
    return sorted(set(imports(path, known)) & known.keys())


@cache
def known():
    """Return modules() with the tests and what they import from their folder."""
    return modules() | {one.stem: one for one in (ROOT / 'test').glob('*.py')
                        if one.stem != 'conftest'}


@cache
def named(path):
    """Return the modules of ours that a test or equipment names."""
    words = {*imports(path, known()), *DOTTED.findall(path.read_text())}
    words |= {f'{word}.__main__' for word in words}
    return {word: known()[word] for word in words if word in known()}


def owner(test):
    """Return the package that a test file belongs to, '' where it is no single one."""
    if f"{FAKES}.{test.stem.removeprefix('test_')}" in known():
        return FAKES
    needed, files = set(), [test]
    for file in files:
        for module, path in named(file).items():
            package = module.partition('.')[0]
            needed |= {package} & LAYERS.keys() - {FAKES}
            if path not in files and (package not in LAYERS or module.startswith(NAMES_OTHERS)):
                files.append(path)
    return next((package for package, below in LAYERS.items() if set() < needed <= below), '')


def main(package='', *options):
    """Run the tests of a package where the others are not; return the exit code."""
    if package not in LAYERS:
        return f"--package {package}: no such package; there are: {', '.join(LAYERS)}"
    tests = [one.relative_to(ROOT) for one in sorted(ROOT.glob('test/test_*.py'))
             if owner(one) == package]
    others = LAYERS.keys() - LAYERS[package] - {FAKES}
    installed = Path(sysconfig.get_path('purelib'))
    starts = [one.read_text() for one in installed.glob('*.pth') if 'editable' not in one.name]
    with tempfile.TemporaryDirectory(prefix='alone_') as place:
        folder = Path(place)
        copy_source(folder)
        for other in others:
            shutil.rmtree(folder / other)
        venv.create(folder / '.venv', 'ROS_DISTRO' in os.environ, symlinks=True)
        [site] = folder.glob('.venv/lib/python*/site-packages')
        (site / 'installed.pth').write_text('\n'.join([place, str(installed), *starts]))
        python = folder / '.venv/bin/python'
        subprocess.run([python, '-c', PRESENT, *others], cwd=folder, check=True)
        return subprocess.run([python, '-m', 'pytest', *tests, *options], cwd=folder,
                              check=False).returncode


if __name__ == '__main__':
    raise SystemExit(main(*sys.argv[1:]))
