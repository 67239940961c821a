# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
A night of a small robot in simulated time, recorded as the dashboard records.

As a program it records to a file, says after each second how far it is, and is meant to be killed.
"""
from pathlib import Path
import sys

sys.path.insert(0, str(Path(__file__).parents[1]))

from synthetic_robot import serialise

from mecarover_dashboard.history import HistoryWriter
from mecarover_dashboard.history_recorder import HistorySampler
from mecarover_dashboard.state import State
from mecarover_dashboard.state import TABLES
from msg_defs.diagnostics import Level
from msg_defs.diagnostics import Status

SERVOS = 3
SICK = 'dxl_monitor: 003 knee'


def servo(number, second, is_hot, is_lost):
    """Return what the monitor says of one servo; the hot one warms up and its voltage falls."""
    temperature = min(80, 40 + second // 300) if is_hot else 40 + number % 3
    voltage = 11.8 - (0.4 if is_hot else 0.0) - 0.1 * (second % 20 == 0)
    values = [('Model', 'XM430-W350'), ('Firmware Version', '45'), ('State', 'connected'),
              ('Loss in 10 s (%)', '0')]
    level, message = Level.OK, 'connected'
    if is_lost:
        values[2:] = [('State', 'disconnected'), ('Loss in 10 s (%)', '100')]
        level, message = Level.ERROR, 'disconnected: 7 answers missed'
    values += [('Present Current (A)', f'{0.1 * (second % 7):.1f}'),
               ('Present Position (rad)', f'{0.01 * (second % 300):.2f}'),
               ('Present Input Voltage (V)', f'{voltage:.1f}'),
               ('Present Temperature (\u00b0C)', str(temperature)),
               ('observed', '{"Present Temperature":[0.1,"r"]}')]
    name = SICK if number == 3 else f'dxl_monitor: {number:03}'
    return Status(name, level, message, str(number), values)


def second_of(second, lost_at):
    """Return the message of one second."""
    servos = [servo(number, second, number == 3, number == 3 and second >= lost_at)
              for number in range(1, SERVOS + 1)]
    errors = [('error 00', f'{lost_at - 1}.000 s: 003: no answer to Read at Present Position')]
    bus = Status('dxl_monitor: bus', Level.OK, 'fine', '', [
        ('Port', '/dev/ttyUSB0'), ('Running for (s)', str(second)),
        *errors[:second >= lost_at - 1]])
    return serialise([bus, *servos])


def record(writer, begin, seconds, lost_at, tell=lambda second: None):
    """Record so many seconds from a Unix time on, one message in each."""
    state, recorder = State(), HistorySampler(writer.errors_until())
    for second in range(seconds):
        state.store_message(TABLES, second_of(second, lost_at), float(second))
        state.expire(float(second))
        recorder.sample_state(state, float(second), begin + second)
        if recorder.is_due(float(second), begin + second):
            writer.write(*recorder.take_batch(begin + second))
        tell(second)
    writer.write(*recorder.take_batch())


if __name__ == '__main__':
    record(HistoryWriter(Path(sys.argv[1])), int(sys.argv[2]), 10_000, 60,
           tell=lambda second: print(int(sys.argv[2]) + second, flush=True))
