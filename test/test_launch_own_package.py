# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The launch test of docs/testing.md, in a folder that is not ours, as its reader runs it."""
import os
import re
import subprocess
import sys

from harness import installed_share
from harness import ROOT
import pytest

SHARE, WHY = installed_share('rclpy', 'launch_ros', 'launch_testing', 'ament_index_python')


@pytest.mark.ros
@pytest.mark.realtime(bears=0.1)
@pytest.mark.slow
@pytest.mark.skipif(bool(WHY), reason=WHY)
def test_the_launch_test_of_the_documents_passes(tmp_path):
    [code] = re.findall(r'```python\n(.*?)```', (ROOT / 'docs/testing.md').read_text(), re.DOTALL)
    file = tmp_path / 'test_my_robot.py'
    file.write_text(code.replace("'/tmp/", f"'{tmp_path}/"))
    path = os.pathsep.join([str(ROOT), os.environ.get('PYTHONPATH', '')])
    done = subprocess.run(
        [sys.executable, '-m', 'launch_testing.launch_test', str(file)], cwd=tmp_path, text=True,
        env={**os.environ, 'PYTHONPATH': path}, timeout=120, stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT)
    assert done.returncode == 0, done.stdout
    assert done.stdout.count('Ran 1 test') == 2, done.stdout       # and after the shutdown
    assert 'no stop could be sent' not in done.stdout
