# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""scripts/setup: what a person sees while it installs; pip is played by a script."""
import os
from pathlib import Path
import platform
import shutil
import subprocess

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = 25
PYTHON = f"""#!/usr/bin/env bash
# Stands for .venv/bin/python -m pip; the call with -e is the one with all packages.
if [[ " $* " != *' -e '* ]]; then
    printf 'Collecting wheel\\nInstalling collected packages: wheel\\n'
    exit
fi
for number in {{1..{PACKAGES}}}; do
    echo "Collecting package-$number>=1"
    echo "  Downloading package_$number-1-py3-none-any.whl (1 kB)"
done
echo 'Installing collected packages: package-1, and so on'
sleep ${{INSTALLING_S:-0}}
[[ -z "${{FAILS:-}}" ]] || {{ echo 'ERROR: no such package' >&2; exit 1; }}
echo 'Successfully installed package-1-1 and so on'
"""

pytestmark = [
    pytest.mark.skipif(shutil.which('bash') is None, reason='skipped: no bash here'),
    pytest.mark.skipif(platform.machine() != 'x86_64', reason='skipped: no ROS wheels for it')]


@pytest.fixture
def tree(tmp_path):
    """Return a tree with an environment; its pip installs nothing."""
    (tmp_path / 'scripts').mkdir()
    shutil.copy(ROOT / 'scripts/setup', tmp_path / 'scripts')
    shutil.copy(ROOT / 'setup.py', tmp_path)
    python = tmp_path / '.venv/bin/python'
    python.parent.mkdir(parents=True)
    python.write_text(PYTHON)
    python.chmod(0o755)
    return tmp_path


def run_setup(tree, code=0, stdout=subprocess.PIPE, **more):
    environment = {**os.environ, **more}
    environment.pop('ROS_DISTRO', None)
    done = subprocess.run([tree / 'scripts/setup'], stdout=stdout, stderr=subprocess.STDOUT,
                          text=True, env=environment, timeout=60)
    assert done.returncode == code, done.stdout
    return (done.stdout or '').splitlines()


def test_a_log_gets_a_line_for_every_tenth_package(tree):
    assert [line.partition(' (')[0] for line in run_setup(tree)] == [
        'setup: installing dashboard ros into .venv, once',
        'setup:   10 packages found', 'setup:   20 packages found',
        'setup:   25 packages found, installing them', 'setup: done']
    assert run_setup(tree) == []            # it is all there


def test_a_failure_is_one_line_at_the_end(tree):
    lines = run_setup(tree, code=1, FAILS='yes')
    assert lines[-1] == 'setup: pip failed: ERROR: no such package; is there a network?'
