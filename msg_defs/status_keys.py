# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Keys of statuses that a program reads again: the web page, the demo, mecarover_status.

Nodes publish under these names and readers look for them, so each is here once, with its place
on the page. A key that only people read is where it is written; docs/diagnostics.md has them
all.
"""

from typing import NamedTuple

# A device.
MODEL = 'Model'
FIRMWARE = 'Firmware Version'
STATE = 'State'                    # a device's, a port's, that of the bridge's commands
ANSWERS = 'Answers'
MISSED_ANSWERS = 'Missed Answers'
LOSS = 'Loss in 10 s (%)'
LATENCY_P50 = 'Reply latency p50 (ms)'
UNOBSERVED_FIELDS = 'Fields not observed'
TEMPERATURES = 'Present Temperature', 'Present Motor Temperature'      # then the unit
VOLTAGES = 'Present Input Voltage', 'Present Voltage'
OBSERVED = 'observed'              # JSON: for each field its age (s), 'r' or 'w'


class Figure(NamedTuple):
    """
    A number of a device that has a column in the page's table.

    digits: significant digits shown. is_rounded: two of them, as it changes with each report.
    """

    name: str
    key: str
    heading: str
    title: str
    digits: int
    is_rounded: bool = False


FIGURES = (Figure('loss', LOSS, 'Loss %', 'Answers missed in 10 s (%)', 2),
           Figure('latency', LATENCY_P50, 'ms', 'Reply latency (ms)', 3, is_rounded=True))

# A port, a subscription, its commands.
PORT = 'Port'
RUNNING = 'Running for (s)'        # a bus: its errors are dated from its start
TOPIC = 'Topic'
MESSAGE_TYPE = 'Message type'
COMMANDS_RECEIVED = 'Commands received'

# Any status: '1 of 2' where a report takes several messages.
PART = 'part'

# What such a key begins with.
FINDING = 'finding.'               # then the rule
SEVERITY = 'severity.'             # then the rule: warn or error
COVERS = 'covers.'                 # then the rule: the devices that suffer, '001-018, 020'
DOUBT = 'cannot tell.'             # then the rule
DEVICE_PROBLEM = 'device '         # in the status of the bus; then its name
ERROR = 'error '                   # then a number: an entry of the error log


def raw(field: str) -> str:
    """Return the key of the number of a field that is shown in words."""
    return f'{field} (raw)'
