# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Who publishes cmd_vel, what that means for our subscription, and what a person should know.

Pure: the node hands in what the ROS graph says. The reasons robots stand still unexplained are
here: a publisher of the other type, incompatible QoS, two publishers fighting; and why two drive.
"""
from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from mecarover_serial.namesakes import DISCOVERED_NS
from vel2d_bridge.bridge_settings import AUTO
from vel2d_bridge.bridge_settings import TWIST
from vel2d_bridge.bridge_settings import TWIST_STAMPED

TYPE_NAMES = {
    'geometry_msgs/msg/Twist': TWIST,
    'geometry_msgs/msg/TwistStamped': TWIST_STAMPED,
}
_KILLED = '; one that was killed counts for up to 20 s more'      # its lease with Fast DDS


class Publisher(NamedTuple):
    """One publisher of cmd_vel; `conflict` says why its QoS does not fit ours ('' if it does)."""

    node: str
    type: str                   # as ROS spells it
    reliable: bool
    conflict: str = ''


class Absence:
    """
    For how long cmd_vel has had no publisher.

    After a start discovery takes up to 2.5 s to find one that is there; until then we cannot tell.
    """

    def __init__(self, now: int) -> None:
        self.had_one = False
        self._since: int | None = now

    def observe(self, is_there: bool, now: int) -> bool:
        """Take what the graph says; return whether the last publisher has left just now."""
        left = not is_there and self._since is None
        self.had_one = self.had_one or is_there
        if is_there:
            self._since = None
        elif left:
            self._since = now
        return left

    def is_long(self, now: int) -> bool:
        return self._since is not None and now - self._since >= DISCOVERED_NS

    @staticmethod
    def words(topic: str) -> str:
        """Return the message for a person: the thing, the reason, the remedy."""
        return f'{topic}: no node publishes it; start teleop_twist_keyboard or your planner'


class Choice(NamedTuple):
    """What to subscribe."""

    message_type: str
    reliable: bool


def choose(setting: str, current: Choice, publishers: Sequence[Publisher]) -> Choice:
    """
    Follow the publishers: their type when they agree, reliable only if all of them are.

    Without a publisher, or with two types at once, the present subscription stays.
    """
    types = {TYPE_NAMES[one.type] for one in publishers if one.type in TYPE_NAMES}
    message_type = current.message_type
    if setting != AUTO:
        message_type = setting
    elif len(types) == 1:
        message_type = types.pop()
    ours = [one for one in publishers if TYPE_NAMES.get(one.type) == message_type]
    reliable = all(one.reliable for one in ours) if ours else current.reliable
    return Choice(message_type, reliable)


def complaints(choice: Choice, publishers: Sequence[Publisher], topic: str,
               bridges: Sequence[str] = ()) -> list[str]:
    """
    Say in a line each what keeps commands from arriving or makes them fight.

    `bridges` are others that hear the topic.
    """
    lines, heard = [], []
    if bridges:
        lines.append(f"{topic}: {', '.join(bridges)} subscribes it too, so one teleop drives "
                     f'{len(bridges) + 1} rovers; end all bridges but one, or give each rover a '
                     'namespace')
    for one in publishers:
        if TYPE_NAMES.get(one.type) != choice.message_type:
            lines.append(
                f'{topic}: {one.node} is not heard, as it publishes {one.type} and the bridge '
                f'subscribes {choice.message_type}; make all publishers agree, or set '
                f'message_type{_KILLED}')
        elif one.conflict:
            lines.append(f'{topic}: {one.node} is not heard, as its QoS is not compatible '
                         f'({one.conflict}); change its QoS or our qos_overrides')
        else:
            heard.append(one.node)
    if len(heard) > 1:
        lines.append(f"{topic}: {len(heard)} publishers compete ({', '.join(sorted(heard))}); "
                     f'stop all but one, or use twist_mux{_KILLED}')
    return lines
