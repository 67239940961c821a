# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Times as people write them."""
from __future__ import annotations

from datetime import datetime
from datetime import timedelta
from datetime import tzinfo
import re

from mecarover_dashboard.rows import finite

EXAMPLES = '-10 min, 14:05, yesterday 9:00, 2026-11-28T14:05 or Unix seconds'
_AGO = re.compile(r'[-\u2212]\s*(\d+(?:\.\d+)?)\s*'
                  r'(d(?:ays?)?|h(?:ours?)?|m(?:in(?:utes?)?)?|s(?:ec(?:onds?)?)?)')
_UNITS_S = {'d': 86400, 'h': 3600, 'm': 60, 's': 1}
_OF_DAY = re.compile(r'(today|yesterday)?\s*(?:(\d\d?):(\d\d)(?::(\d\d))?)?')
_LAST_S = 1e11


def unix_time(text: str, now_s: float, zone: tzinfo | None) -> float | None:
    """
    Return what a text means in Unix seconds, None where it is no time.

    A time of day without a day is the last one before now. zone: None = that of this machine.
    """
    number = finite(text)
    try:
        at_s = _moment(text.strip(), now_s, zone) if number is None else number
    except (ValueError, OverflowError):
        return None
    return at_s if 0 <= at_s < _LAST_S else None


def _moment(text: str, now_s: float, zone: tzinfo | None) -> float:
    if ago := _AGO.fullmatch(text.lower()):
        return now_s - float(ago[1]) * _UNITS_S[ago[2][0]]
    now = datetime.fromtimestamp(now_s, zone)
    if text and (found := _OF_DAY.fullmatch(text.lower())):
        day, *clock = found.groups()
        hour, minute, second = (int(one or 0) for one in clock)
        at = now.replace(hour=hour, minute=minute, second=second, microsecond=0)
        is_earlier = day == 'yesterday' or (day is None and at > now)
        return (at - timedelta(days=is_earlier)).timestamp()
    if text.lower() == 'now':
        return now_s
    # The + of a time zone that is not encoded in an address arrives as a space.
    at = datetime.fromisoformat(re.sub(r'(:\d\d) (\d\d:\d\d)$', r'\1+\2', text).replace(
        'Z', '+00:00'))
    return (at if at.tzinfo else at.replace(tzinfo=zone)).timestamp()
