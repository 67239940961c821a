# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Dynamixel 1.0 or Feetech: the frame is the same, so what is said decides.

Each sign speaks for one of the two, a strong one as much as several weak ones. Without enough of
them it stays undecided, and that is shown. Signs: instructions that only one of them has; the
addresses that a master uses all the time; a model number that only one of them has.
"""

from collections.abc import Iterable

from msg_defs.dxl1_instruction import Dialect
from msg_defs.dxl1_instruction import DYNAMIXEL_1
from msg_defs.dxl1_instruction import FEETECH
from msg_defs.dxl1_instruction import UNDECIDED
from msg_defs.dxl_instruction import Instruction
from msg_defs.dxl_instruction import Request
from servobus.model.layers import model_key
from servobus.model.models import Models

STRONG_VOTE = 4                    # as much decides, if the other has no more than a quarter of it
WEAK_VOTE = 1
# Of Dynamixel: Torque Enable to Moving Speed, Present Position. Of Feetech: Torque Enable,
# Acceleration and Goal Position, Present Position and more. The other has something else there.
DYNAMIXEL_USES = {(24, 1), (25, 1), (30, 2), (30, 4), (32, 2), (36, 2), (36, 4), (36, 6), (36, 8)}
FEETECH_USES = {(41, 7), (42, 2), (42, 6), (55, 1)}
FEETECH_READS = range(56, 67)      # Present Position and more; no Dynamixel has a register there
_LOCK_WRITE = Instruction.WRITE, (55, 1)       # no Dynamixel 1.0 has a register there
_BY_PROTOCOL = {'1': DYNAMIXEL_1, 'feetech': FEETECH}


class DialectChoice:
    """Which dialect of the family this bus speaks. protocol: as the parameter `protocols`."""

    def __init__(self, models: Models, protocol: str = 'auto') -> None:
        self._models = models
        self._is_fixed = protocol in _BY_PROTOCOL
        self.dialect: Dialect = _BY_PROTOCOL.get(protocol, UNDECIDED)
        self._votes = {DYNAMIXEL_1.name: 0, FEETECH.name: 0}

    def vote_by_devices(self, dialects: Iterable[Dialect | None]) -> None:
        """Take the devices that the user listed as a sign."""
        for dialect in {one.name: one for one in dialects if one is not None}.values():
            self._vote(dialect, STRONG_VOTE)

    def vote_by_instruction(self, request: Request) -> bool:
        """Take an instruction as a sign; return whether that decided."""
        code = request.instruction
        where = request.accesses[0][1:3] if request.accesses else None
        if code in DYNAMIXEL_1.entries and code not in FEETECH.entries:
            return self._vote(DYNAMIXEL_1, STRONG_VOTE)
        if where in DYNAMIXEL_USES:          # a Sync Read too, which it has not
            return self._vote(DYNAMIXEL_1, WEAK_VOTE)
        if code in FEETECH.entries and code not in DYNAMIXEL_1.entries:
            return self._vote(FEETECH, STRONG_VOTE)
        if where in FEETECH_USES or request.address in FEETECH_READS:
            return self._vote(FEETECH, STRONG_VOTE if (code, where) == _LOCK_WRITE else WEAK_VOTE)
        return False

    def vote_by_model_number(self, request: Request, data: bytes) -> bool:
        """Take a model number that was read as a sign; return whether that decided."""
        if request.instruction != Instruction.READ or not request.accesses:
            return False
        access = request.accesses[0]
        for dialect, protocol in ((DYNAMIXEL_1, '1'), (FEETECH, 'feetech')):
            at = dialect.identity_at - access.address
            if 0 <= at <= len(data) - 2:
                model = self._models.get(model_key(data[at] | data[at + 1] << 8, protocol))
                if model is not None and model.protocol == protocol:
                    return self._vote(dialect, STRONG_VOTE)
        return False

    def _vote(self, dialect: Dialect, weight: int) -> bool:
        if self._is_fixed:
            return False
        votes = self._votes
        if votes[dialect.name] < 4 * STRONG_VOTE:
            votes[dialect.name] += weight
        other = FEETECH if dialect is DYNAMIXEL_1 else DYNAMIXEL_1
        if self.dialect is dialect \
                or votes[dialect.name] < max(STRONG_VOTE, 4 * votes[other.name]):
            return False
        self.dialect = dialect
        return True
