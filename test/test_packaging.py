# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What `ros2 run` and `ros2 launch` need to find after a plain pip install into a fresh prefix."""
import ast
from email import message_from_bytes
from importlib.util import find_spec
import os
from pathlib import Path
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

import pytest

from mecarover_serial.command import COMMANDS
from servobus.tools.command import COMMANDS as TOOLS

ROOT = Path(__file__).parents[1]
NAME = 'mecarover_serial'


def copy_tree(to, *keep_out):
    shutil.copytree(ROOT, to, symlinks=True, dirs_exist_ok=True, ignore=shutil.ignore_patterns(
        '.venv', '.git', '.*_cache', '.hypothesis', 'build', '*.egg-info', '__pycache__',
        *keep_out))


@pytest.fixture(scope='module')
def tree(tmp_path_factory):
    tree = tmp_path_factory.mktemp('tree') / NAME
    copy_tree(tree)
    return tree


def pip(*arguments, cwd):
    """Run pip, which asks no network."""
    command, *more = arguments
    subprocess.run([sys.executable, '-m', 'pip', command, '--quiet', '--no-deps', '--no-index',
                    '--no-build-isolation', *more], cwd=cwd, check=True)


@pytest.fixture(scope='module')
def prefix(tree, tmp_path_factory):
    """Install a copy of the tree, as `pip install .` does."""
    prefix = tmp_path_factory.mktemp('prefix')
    pip('install', '--ignore-installed', '--prefix', prefix, '.', cwd=tree)
    link_libraries(prefix)
    return prefix


@pytest.fixture(scope='module')
def alone(tree, tmp_path_factory):
    """Install the wheel dxl-doctor, made of its sdist, and no more than it declares."""
    made, prefix = tmp_path_factory.mktemp('made'), tmp_path_factory.mktemp('alone')
    subprocess.run([sys.executable, '-c', 'import sys; from setuptools import build_meta; '
                    'build_meta.build_sdist(sys.argv[1])', made],
                   cwd=tree / 'packaging/dxl-doctor', check=True, stdout=subprocess.DEVNULL)
    [sdist] = made.iterdir()
    pip('wheel', '--wheel-dir', made, sdist, cwd=made)
    [wheel] = made.glob('*.whl')
    assert max(sdist.stat().st_size, wheel.stat().st_size) < 1_000_000
    pip('install', '--ignore-installed', '--prefix', prefix, wheel, cwd=made)
    link_libraries(prefix)
    return prefix


def link_libraries(prefix):
    """Let a prefix have what its package declares, from the environment of the tests."""
    for name in ('serial', 'yaml', 'crcmod'):
        (packages(prefix) / name).symlink_to(Path(find_spec(name).origin).parent)


def packages(prefix):
    [found] = prefix.glob('lib/python*/site-packages')
    return found


def run_alone(prefix, *arguments):
    """Run Python with what a prefix holds; -S: nothing of the environment of the tests."""
    return subprocess.run(
        [sys.executable, '-S', *map(str, arguments)], cwd=prefix, timeout=60, text=True,
        env={**os.environ, 'PYTHONPATH': str(packages(prefix))}, capture_output=True)


def about(prefix):
    """Return version and requirements of what a prefix holds."""
    [metadata] = packages(prefix).glob('*.dist-info/METADATA')
    text = message_from_bytes(metadata.read_bytes())
    return text['Version'], {one.replace(' ', '') for one in text.get_all('Requires-Dist')
                             if 'extra ==' not in one or 'mcap' in one.partition(';')[2]}


def files(folder):
    return {path.relative_to(folder) for path in folder.rglob('*')
            if path.is_file() and '__pycache__' not in path.parts}


@pytest.mark.more
def test_the_library_alone_is_as_in_the_whole_and_no_more(prefix, alone):
    assert about(alone) == about(prefix)
    for package in ('msg_defs', 'servobus'):
        assert files(packages(alone) / package) == files(packages(prefix) / package) \
            == files(ROOT / package)
    assert {path.name for path in packages(alone).iterdir() if not path.is_symlink()} \
        == {'msg_defs', 'servobus', f'dxl_doctor-{about(alone)[0]}.dist-info'}
    assert {path.name for path in (alone / 'bin').iterdir()} \
        == {*TOOLS, *(name.replace('_', '-') for name in TOOLS)}


@pytest.mark.more
def test_each_module_of_the_library_alone_needs_no_other_package_of_ours(alone):
    done = run_alone(alone, '-c', """
import importlib, pkgutil, sys
import msg_defs, servobus
for package in (msg_defs, servobus):
    for found in pkgutil.walk_packages(package.__path__, package.__name__ + '.'):
        if found.name != 'msg_defs.ros' and '.sitecustomize' not in found.name:
            importlib.import_module(found.name)
print(servobus.__file__, *{name.partition('.')[0] for name in sys.modules})""")
    assert done.stderr == ''
    place, *loaded = done.stdout.split()
    assert place == str(packages(alone) / 'servobus/__init__.py')
    assert not {'rclpy', 'dxl_monitor', 'vel2d_bridge'} & {*loaded}
    assert not [name for name in loaded if name.startswith('mecarover')]


@pytest.mark.more
@pytest.mark.parametrize('tool', TOOLS)
def test_the_version_of_a_tool_is_that_of_the_package_that_holds_it(prefix, alone, tool):
    for place, package in ((alone, 'dxl-doctor'), (prefix, NAME)):
        done = run_alone(place, '-m', TOOLS[tool], '--version')
        assert (done.stdout, done.stderr) == (f'{tool} ({package}) {about(place)[0]}\n', '')


@pytest.mark.more
def test_index_marker_and_share(prefix):
    share = prefix / 'share'
    assert (share / 'ament_index/resource_index/packages' / NAME).read_text() == ''
    assert (share / NAME / 'package.xml').read_bytes() == (ROOT / 'package.xml').read_bytes()
    for folder, *patterns in (('launch', '*.launch.py'), ('config', '*'), ('deploy', '*'),
                            ('docs', '*.md', '*.json'), ('firmware', '*')):
        here = {path.name for pattern in patterns for path in (ROOT / folder).glob(pattern)}
        there = {path.name for path in (share / NAME / folder).glob('*')}
        assert here ^ there <= {'__pycache__'}              # pip compiles what it installs


@pytest.mark.more
@pytest.mark.parametrize('tool', COMMANDS)
def test_ros2_run_finds_and_starts(prefix, tool):
    executable = prefix / 'lib' / NAME / tool
    assert os.access(executable, os.X_OK)
    assert os.access(prefix / 'bin' / tool, os.X_OK)
    done = subprocess.run([sys.executable, executable, '--help'], cwd=prefix, timeout=60,
                          env={**os.environ, 'PYTHONPATH': str(packages(prefix)), 'COLUMNS': '80'},
                          capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert 'usage' in done.stdout.lower()
    assert max(map(len, done.stdout.splitlines())) <= 80


def test_wrappers_are_the_commands():
    wrappers = {path.name: path.read_text()
                for path in (ROOT / 'resource/executables').iterdir()}
    assert wrappers.keys() == COMMANDS.keys()
    for name, text in wrappers.items():
        assert text.endswith(f'import {name}\n\nsys.exit({name}())\n')


def test_package_xml_names_what_is_imported():
    package = ElementTree.parse(ROOT / 'package.xml').getroot()
    depends = {entry.text for entry in package.iter('exec_depend')}
    for path in ROOT.glob('*/**/*.py'):
        if path.relative_to(ROOT).parts[0] not in ('msg_defs', NAME, 'vel2d_bridge',
                                                   'dxl_monitor', 'launch'):
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            module = node.module if isinstance(node, ast.ImportFrom) else ''
            top = (module or '').partition('.')[0]
            if top in ('rclpy', 'launch', 'launch_ros', 'ament_index_python') \
                    or top.endswith(('_msgs', '_interfaces', '_srvs')):
                assert top in depends, f'{path} imports {top}'
    assert package.find('export/build_type').text == 'ament_python'
    assert package.get('format') == '3'
