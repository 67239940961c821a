# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The demo's verdicts, without its processes; scripts/demo itself is run by hand and in CI."""

import pytest
from synthetic_robot import serialise
from synthetic_robot import SyntheticRobot

from mecarover_dashboard.state import State
from mecarover_dashboard.state import TABLES
from mecarover_fakes.demo.device_watch import DeviceWatch
from mecarover_fakes.demo.scenes import judge_missed


@pytest.mark.parametrize('missed, overrun, passed, text', [
    ({6: 0, 7: 9}, 0, True, '9 counted, 10 simulated'),
    ({6: 1, 7: 9}, 0, False, '006: 1 counted, 0 simulated'),
    ({6: 1, 7: 9}, 40, True, 'unknown: the busy computer lost 40 bytes'),
    ({6: 0, 7: 9, 55: 3}, 0, False, '055: 3 counted, 0 simulated'),
])
def test_missed_answers_are_those_of_the_fakes_books(missed, overrun, passed, text):
    truth = {'devices': {'6': {'missed': 0}, '7': {'missed': 10}},
             'totals': {'bus': {'overrun': overrun}}}
    verdict = judge_missed(missed, truth)
    assert (verdict.passed, verdict.text) == (passed, text)


def test_the_table_of_the_demo_fits_a_terminal_and_names_the_boards():
    robot, state = SyntheticRobot(), State()
    robot.lost = {7}
    state.store_message(TABLES, serialise(robot.tables(1.0)), 1.0)
    watch = DeviceWatch(state)
    watch.page = 'http://127.0.0.1:8420'
    heading, *servos, boards, page = watch.table(1.0, 79)
    assert max(map(len, [heading, *servos, boards, page])) <= 79
    assert [line.split()[1] for line in servos] == [f'{number:03}' for number in range(1, 21)]
    assert boards == \
        'ok      4 boards without position: Rhoban DXL Board, BitFoot, Bit-Bots IMU'
    assert page.endswith(' page: http://127.0.0.1:8420')


def test_one_change_of_several_devices_is_one_line_and_the_first_is_none(capsys, monkeypatch):
    monkeypatch.setenv('COLUMNS', '200')
    robot, state = SyntheticRobot(), State()
    watch = DeviceWatch(state)
    watch._seen[1] = ['expected']
    for waiting in (set(), set(), {8, 9}):
        robot.waiting = waiting
        state.store_message(TABLES, serialise(robot.tables(1.0)), 1.0)
        watch.show(-10.0)
        robot._made_s = None
    assert capsys.readouterr().out.splitlines() == [
        '     bus  008, 009: connected -> waiting (asked but not served: 007 before it does not '
        'answer)']
