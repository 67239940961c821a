# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Which publisher of cmd_vel is followed, and what is said of the others. No ROS here."""
from pathlib import Path

import pytest
import yaml

from mecarover_serial.namesakes import Namesakes
from mecarover_serial.namesakes import node_name
from vel2d_bridge.bridge_settings import TWIST
from vel2d_bridge.graph import Absence
from vel2d_bridge.graph import Choice
from vel2d_bridge.graph import choose
from vel2d_bridge.graph import complaints
from vel2d_bridge.graph import Publisher

PLAIN = Publisher('/teleop', 'geometry_msgs/msg/Twist', reliable=True)
LOSSY = PLAIN._replace(node='/joystick', reliable=False)
STAMPED = Publisher('/planner', 'geometry_msgs/msg/TwistStamped', reliable=True)
CHATTER = Publisher('/talker', 'std_msgs/msg/String', reliable=True)
MISFIT = PLAIN._replace(node='/misfit', conflict='Best effort publisher, reliable subscription')
PUBLISHERS = {'plain': PLAIN, 'lossy': LOSSY, 'stamped': STAMPED, 'chatter': CHATTER,
              'misfit': MISFIT}
ROWS = yaml.safe_load(Path(__file__).with_name('publishers.yaml').read_text())
TOPIC = '/cmd_vel'
S = 1_000_000_000


@pytest.mark.parametrize(('setting', 'current', 'names', 'choice'), ROWS['choice'])
def test_choice(setting, current, names, choice):
    publishers = [PUBLISHERS[name] for name in names]
    assert choose(setting, Choice(*current), publishers) == Choice(*choice)
    assert choose(setting, Choice(*current), publishers[::-1]) == Choice(*choice)


@pytest.mark.parametrize(('names', 'parts'), ROWS['complaints'])
def test_complaints(names, parts):
    lines = complaints(Choice(TWIST, True), [PUBLISHERS[name] for name in names], TOPIC)
    assert len(lines) == len(parts)
    for line, expected in zip(lines, parts, strict=True):
        assert line.startswith(f'{TOPIC}: ')                        # thing: reason; remedy
        assert '; ' in line
        assert all(part in line for part in expected)


@pytest.mark.parametrize(('namespace', 'name', 'full'), [
    ('/', 'teleop', '/teleop'),
    ('/rover', 'teleop', '/rover/teleop'),
    ('_NODE_NAMESPACE_UNKNOWN_', '_NODE_NAME_UNKNOWN_', 'a node without a name'),
])
def test_node_name(namespace, name, full):
    assert node_name(namespace, name) == full


def test_a_missing_publisher_is_news_after_three_seconds():
    """Discovery takes up to 2.5 s; and who has left is told once, at once."""
    absence = Absence(10 * S)
    assert [absence.observe(False, 10 * S), absence.is_long(12 * S)] == [False, False]
    assert absence.is_long(13 * S)
    assert not absence.had_one
    assert not absence.observe(True, 20 * S)
    assert not absence.is_long(30 * S)
    assert [absence.observe(False, 31 * S), absence.observe(False, 32 * S)] == [True, False]
    assert [absence.is_long(33 * S), absence.is_long(34 * S)] == [False, True]
    assert absence.had_one
    line = Absence.words(TOPIC)
    assert line.startswith(f'{TOPIC}: no node publishes it; start teleop_twist_keyboard')


def test_another_bridge_on_the_topic_is_named():
    assert complaints(Choice(TWIST, True), [PLAIN], TOPIC) == []
    [line] = complaints(Choice(TWIST, True), [PLAIN], TOPIC, ['/left', '/right'])
    assert line.startswith(
        f'{TOPIC}: /left, /right subscribes it too, so one teleop drives 3 rovers; ')


NAME = '/rover1/vel2d_bridge'
ONE, OTHER = ('vel2d_bridge', '/rover1'), ('vel2d_bridge', '/rover2')


@pytest.mark.parametrize(('looks', 'said'), yaml.safe_load(
    Path(__file__).with_name('namesakes.yaml').read_text(encoding='utf-8')))
def test_a_node_of_our_name_is_said(looks, said):
    namesakes = Namesakes(NAME, 10 * S)
    lines = {at: namesakes.complaints([OTHER, *count * [ONE]], (10 + at) * S)
             for at, count in looks}
    assert [at for at, found in lines.items() if found] == said
    for at in said:
        assert lines[at][0].startswith(f'{NAME}: {dict(looks)[at]} nodes have this name, ')
