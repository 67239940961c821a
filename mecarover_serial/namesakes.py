# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Other nodes with the name of ours: their statuses take turns, and services reach only one of them.

Pure: the node hands in what the ROS graph says.
"""
from __future__ import annotations

from collections.abc import Iterable

DISCOVERED_NS = 3_000_000_000       # after a start: until then what was there is found (2.5 s)
FORGOTTEN_NS = 25_000_000_000       # by then the graph has forgotten a node that was killed (20 s)


def node_name(namespace: str, name: str) -> str:
    """Return the full name of a node; discovery may not know it yet, or it is none of ROS."""
    if 'UNKNOWN' in name:
        return 'a node without a name'
    return f'{namespace.rstrip("/")}/{name}'


class Namesakes:
    """
    Says when a node has the full name of ours.

    One that was in the graph when we started may be a node that was killed, and we the one that
    was started in its place: that is a complaint only when the graph had time to forget it.
    """

    def __init__(self, name: str, now: int) -> None:
        self._name = name
        self._started = now
        self._old = 0               # namesakes that were there at our start

    def complaints(self, nodes: Iterable[tuple[str, str]], now: int) -> list[str]:
        """Return a line when there is one among `nodes`, name and namespace of each."""
        others = sum(node_name(namespace, name) == self._name for name, namespace in nodes) - 1
        age = now - self._started
        self._old = others if age < DISCOVERED_NS else min(self._old, others)
        if others < 1 or (others <= self._old and age < FORGOTTEN_NS):
            return []
        return [f'{self._name}: {others + 1} nodes have this name, so their statuses and services '
                'are mixed up; end all but one, or give each a namespace (-r __ns:=/NAME, '
                'namespace:=NAME with ros2 launch)']
