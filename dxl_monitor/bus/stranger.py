# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Whether an ID that the 1.0 family names for the first time exists.

A sum of eight bits lets one of 256 damaged frames pass. Such a frame is the rest of one packet and
the beginning of the next, and it may name any ID; what is left of the next one follows as noise.
So a frame that names a new ID is believed by what is around it, or when the ID comes again.
"""

from typing import Any
from typing import NamedTuple

from dxl_monitor.bus.roster import Roster
from msg_defs.dxl1_packet import BROADCAST
from msg_defs.dxl1_packet import ends_with_another
from msg_defs.dxl_packet import Frame

SIGHTINGS = 3                      # on a bus with stray bytes, noise is around all packets
SIGHTING_NS = 1_000_000_000        # at most, from one to the next
# Where the IDs begin in the body of what is said to several, and how far apart they are: 0 for
# one more than the size that stands in front of them.
_LISTS = {0x82: (6, 1), 0x83: (6, 0), 0x92: (6, 3)}


class Held(NamedTuple):
    """A good frame that is not believed yet, and where it came from; received: of its chunk."""

    framer: Any                    # a MixedFramer, or one of the 1.0 family alone
    frame: Frame
    stamp: int
    received: int
    side: str


class Strangers:
    """The IDs that were named, and are no devices of the roster yet."""

    def __init__(self, roster: Roster) -> None:
        self._devices = roster.devices
        self._sightings: dict[int, tuple[int, int]] = {}       # how often, when at last
        self._known = b''              # the IDs of the last list, all of them devices

    def new_id(self, body: bytes) -> int | None:
        """Return an ID that a frame names and that is new, if there is one."""
        if body[0] != BROADCAST:
            return None if body[0] in self._devices else body[0]
        ids = _listed(body)
        if ids == self._known:
            return None
        new = next((one for one in ids if one not in self._devices), None)
        if new is None:
            self._known = ids
        return new

    def exists(self, held: Held, is_next: bool) -> bool:
        """Return whether to believe a frame; is_next: there is no noise behind it."""
        _, body, flaw = held.frame
        number = self.new_id(body)
        if number is None:
            return True
        is_alone = is_next and (flaw is None or not flaw.noise_length)
        # Of a list that lost a byte, some IDs are those of devices.
        is_torn = any(one in self._devices for one in _listed(body)) or ends_with_another(body)
        if is_alone and not is_torn:
            return True
        count, last = self._sightings.get(number, (0, 0))
        count = count + 1 if held.stamp - last <= SIGHTING_NS else 1
        self._sightings[number] = count, held.stamp
        return count >= SIGHTINGS


def _listed(body: bytes) -> bytes:
    begin, step = _LISTS.get(body[3], (0, 0))
    if body[0] != BROADCAST or not begin or len(body) <= begin:
        return b''
    return body[begin::step or body[5] + 1]
