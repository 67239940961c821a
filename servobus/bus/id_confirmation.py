# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
ID confirmation: whether an ID that the 1.0 family names for the first time exists.

A sum of eight bits lets one of 256 damaged frames pass. Such a frame is the rest of one packet and
the beginning of the next, and it may name any ID; what is left of the next one follows as noise.
So a frame that names a new ID is believed by what is around it, or when the ID comes again.
"""

from msg_defs.dxl1_packet import BROADCAST
from msg_defs.dxl1_packet import ends_with_another
from msg_defs.servo_frame import Frame
from servobus.bus.registry import DeviceRegistry

SIGHTINGS_NEEDED = 3               # on a bus with stray bytes, noise is around all packets
SIGHTING_GAP_MAX_NS = 1_000_000_000  # at most, from one to the next
# Where the IDs begin in the parameters of what is said to several, and how far apart they are: 0
# for one more than the size before them.
_ID_LISTS = {0x82: (2, 1), 0x83: (2, 0), 0x92: (2, 3)}


class IdConfirmation:
    """The IDs that were named, and are no devices of the registry yet."""

    def __init__(self, registry: DeviceRegistry) -> None:
        self._devices = registry.devices
        self._sightings: dict[int, tuple[int, int]] = {}       # how often, when at last
        self._known = b''              # the IDs of the last list, all of them devices

    def new_id(self, number: int, code: int, params: bytes) -> int | None:
        """Return an ID that a frame names and that is new, if there is one."""
        if number != BROADCAST:
            return None if number in self._devices else number
        ids = _listed(number, code, params)
        if ids == self._known:
            return None
        new = next((one for one in ids if one not in self._devices), None)
        if new is None:
            self._known = ids
        return new

    def exists(self, frame: Frame, stamp: int, is_next: bool) -> bool:
        """Return whether to believe a frame; is_next: there is no noise after it."""
        _, _, _, sender, code, params, flaw = frame
        number = self.new_id(sender, code, params)
        if number is None:
            return True
        is_alone = is_next and (flaw is None or not flaw.noise_length)
        # Of a list that lost a byte, some IDs are those of devices.
        is_torn = any(one in self._devices for one in _listed(sender, code, params)) \
            or ends_with_another(frame)
        if is_alone and not is_torn:
            return True
        count, last = self._sightings.get(number, (0, 0))
        count = count + 1 if stamp - last <= SIGHTING_GAP_MAX_NS else 1
        self._sightings[number] = count, stamp
        return count >= SIGHTINGS_NEEDED


def _listed(number: int, code: int, params: bytes) -> bytes:
    begin, step = _ID_LISTS.get(code, (0, 0))
    if number != BROADCAST or not begin or len(params) <= begin:
        return b''
    return params[begin::step or params[1] + 1]
