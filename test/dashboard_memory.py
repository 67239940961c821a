# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What the history of 253 devices costs in memory over a day, as a table: not a test.

    .venv/bin/python test/dashboard_memory.py [HOURS]

Real reports fill the state of the server; then simulated time goes on, and in each window of 10 s
every device has moved. With and without a history, each in a process of its own; then all of the
day is asked for. Memory: what the process has filled
itself (RssAnon), in MB, and the most it ever had (VmHWM, libraries included).
"""
import math
from pathlib import Path
import subprocess
import sys
from tempfile import TemporaryDirectory
import time
from urllib.parse import urlencode
from urllib.request import urlopen

sys.path.insert(0, str(Path(__file__).parents[1]))

from dashboard_page import Dashboard
from synthetic_robot import MANY
from synthetic_robot import SyntheticRobot

from mecarover_dashboard.history import WINDOW_S
from mecarover_dashboard.history_recorder import HistoryRecorder
from mecarover_dashboard.rows import Values
from mecarover_dashboard.state import State

HOUR = 3600


def memory_mb():
    """Return what this process has filled, and the most it ever had."""
    found = dict(line.split(':') for line in Path('/proc/self/status').read_text().splitlines())
    return [int(found[key].split()[0]) / 1024 for key in ('RssAnon', 'VmHWM')]


def show(what):
    own, most = memory_mb()
    print(f'  {what:34} {own:6.1f} MB   {most:6.1f} MB', flush=True)


def feed(state, hours, path):
    """Let all devices move for so many hours; with a history where there is a path."""
    end = int(time.time())
    recording = path and HistoryRecorder(path)
    for second in range(0, int(hours * HOUR), WINDOW_S):
        move(state, second)
        if recording:
            recording.look(state, float(second), end - hours * HOUR + second)
            while recording._batches.qsize():           # as fast as the disk takes it
                time.sleep(0.001)
        if second % (6 * HOUR) == 0:
            show(f'after {second // HOUR} h')
    if recording:
        recording.close()
    show(f'after {hours:g} h')
    return end


def move(state, second):
    """Report every device as it is by now, with all values different from those before."""
    for at, entry in enumerate(state._entries['devices'].values()):
        turn = math.sin(second / 100 + at)
        entry.arrived = float(second)
        entry.values = Values(f'{turn:.4f}', f'{50 + 10 * turn:.0f}', f'{12 + turn / 2:.1f}',
                              f'{turn / 3:.3f}', 'A')


def ask(path, begin, end):
    """Ask for everything there is, in both formats."""
    with Dashboard(history=path) as dashboard:
        for what in ('events', 'values'):
            for form in ('json', 'csv'):
                query = urlencode({'from': begin, 'to': end, 'format': form})
                with urlopen(f'{dashboard.address}history/{what}?{query}', timeout=600) as answer:
                    size = sum(map(len, iter(lambda: answer.read(65536), b'')))
                show(f'{what} as {form}, {size / 1e6:.1f} MB')


def main(hours, path=None):
    if path is None:
        with TemporaryDirectory() as folder:
            for name in ('none', f'{folder}/history.sqlite'):
                print('without a history' if name == 'none' else 'with a history')
                subprocess.run([sys.executable, __file__, str(hours), name], check=True)
        return
    robot = SyntheticRobot({'': MANY})
    path, state = None if path == 'none' else Path(path), State()
    for topic, message in robot.messages(100.0):
        state.take(topic, message, 0.0)
    show('253 devices known')
    end = feed(state, hours, path)
    if path:
        print(f'  {path.stat().st_size / 1e6:.1f} MB on disk')
        ask(path, end - int(hours * HOUR), end)


if __name__ == '__main__':
    main(float(sys.argv[1]) if sys.argv[1:] else 24.0, *sys.argv[2:3])
