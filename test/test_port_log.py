# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The news of the port: bounded, in order, and what is left out is counted."""
from threading import Thread

from servobus.port.port_error import PortError
from servobus.port.port_error import Reason
from vel2d_bridge.port_log import KEPT
from vel2d_bridge.port_log import PortLog


def loss(number):
    return PortError('/dev/ttyAMA0', Reason('lost', f'gone {number}', 'check the plug'))


def test_everything_is_told_once_and_in_order():
    news = PortLog()
    losses = [loss(number) for number in range(KEPT // 2)]
    for one in losses:
        news.add(one)
        news.add(None)
    assert list(news.take_changes()) == [one for pair in losses for one in (pair, None)]
    assert list(news.take_changes()) == []
    assert news.left_out() == 0


def test_a_port_that_comes_and_goes_while_the_node_is_held_up():
    """No more than KEPT are held, the newest among them; the others are counted, and told once."""
    news = PortLog()
    losses = [loss(number) for number in range(50 * KEPT)]
    for one in losses:
        news.add(one)
    assert (news.left_out(), news.left_out()) == (49 * KEPT, 0)
    assert list(news.take_changes()) == losses[-KEPT:]
    news.add(None)
    assert (list(news.take_changes()), news.left_out()) == ([None], 0)


def test_what_one_thread_adds_another_takes():
    """Nothing is lost uncounted, nothing comes twice, the last is never left out."""
    news, losses, taken = PortLog(), [loss(number) for number in range(20_000)], []

    def fill():
        for one in losses:
            news.add(one)

    thread = Thread(target=fill)
    thread.start()
    while thread.is_alive():
        taken.extend(news.take_changes())
    thread.join()
    taken.extend(news.take_changes())
    numbers = [losses.index(one) for one in taken[-2 * KEPT:]]
    assert numbers == sorted(set(numbers))
    assert taken[-1] is losses[-1]
    assert len(taken) + news.left_out() == len(losses)
