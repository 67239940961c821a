# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What `ros2 run` and `ros2 launch` need to find after a plain pip install into a fresh prefix."""
import ast
import os
from pathlib import Path
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

import pytest

from mecarover_serial.command import COMMANDS

ROOT = Path(__file__).parents[1]
NAME = 'mecarover_serial'


def copy_tree(to, *keep_out):
    shutil.copytree(ROOT, to, dirs_exist_ok=True, ignore=shutil.ignore_patterns(
        '.venv', '.git', '.*_cache', '.hypothesis', 'build', '*.egg-info', '__pycache__',
        *keep_out))


@pytest.fixture(scope='module')
def prefix(tmp_path_factory):
    """Install a copy of the tree, as `pip install .` does, without asking the network."""
    tree = tmp_path_factory.mktemp('tree') / NAME
    copy_tree(tree)
    prefix = tmp_path_factory.mktemp('prefix')
    subprocess.run([sys.executable, '-m', 'pip', 'install', '--quiet', '--no-deps', '--no-index',
                    '--no-build-isolation', '--ignore-installed', '--prefix', prefix, '.'],
                   cwd=tree, check=True)
    return prefix


@pytest.mark.more
def test_index_marker_and_share(prefix):
    share = prefix / 'share'
    assert (share / 'ament_index/resource_index/packages' / NAME).read_text() == ''
    assert (share / NAME / 'package.xml').read_bytes() == (ROOT / 'package.xml').read_bytes()
    for folder, pattern in (('launch', '*.launch.py'), ('config', '*'), ('deploy', '*'),
                            ('docs', '*.md'), ('firmware', '*')):
        here = {path.name for path in (ROOT / folder).glob(pattern)}
        there = {path.name for path in (share / NAME / folder).glob('*')}
        assert here ^ there <= {'__pycache__'}              # pip compiles what it installs


@pytest.mark.more
@pytest.mark.parametrize('tool', COMMANDS)
def test_ros2_run_finds_and_starts(prefix, tool):
    executable = prefix / 'lib' / NAME / tool
    assert os.access(executable, os.X_OK)
    assert os.access(prefix / 'bin' / tool, os.X_OK)
    [packages] = prefix.glob('lib/python*/site-packages')
    done = subprocess.run([sys.executable, executable, '--help'], cwd=prefix, timeout=60,
                          env={**os.environ, 'PYTHONPATH': str(packages), 'COLUMNS': '80'},
                          capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert 'usage' in done.stdout.lower()
    assert max(map(len, done.stdout.splitlines())) <= 80


@pytest.mark.more
def test_models_are_installed(prefix):
    [models] = prefix.glob('lib/python*/site-packages/servobus/model/files')
    assert {path.name for path in models.glob('*.yaml')} \
        == {path.name for path in (ROOT / 'servobus/model/files').glob('*.yaml')} != set()


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


@pytest.mark.parametrize('package', ['msg_defs', 'servobus', NAME, 'vel2d_bridge', 'dxl_monitor',
                                     'mecarover_dashboard', 'mecarover_fakes', 'launch'])
def test_no_text_for_a_user_points_to_what_is_not_installed(package):
    """The documents and deploy/ stay in the repository; docstrings and comments may name them."""
    found = set()
    for path in (ROOT / package).rglob('*.py'):
        tree = ast.parse(path.read_text())
        docstrings = {ast.get_docstring(node, clean=False) for node in ast.walk(tree)
                      if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)}
        found |= {(path.name, node.lineno, node.value) for node in ast.walk(tree)
                  if isinstance(node, ast.Constant) and isinstance(node.value, str)
                  and node.value not in docstrings
                  and any(folder in node.value for folder in ('docs/', 'deploy/'))}
    assert found == set()
