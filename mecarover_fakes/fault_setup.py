# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Faults of servos that were not set up for this robot, or wrongly; mostly of the 1.0 family."""

from __future__ import annotations

from collections.abc import Iterable

from mecarover_fakes.dxl1_servo import MIDDLE
from mecarover_fakes.fake_servo import FakeDevice
from mecarover_fakes.fault import Effect
from mecarover_fakes.fault_device import Hot
from mecarover_fakes.traffic import Ask
from mecarover_fakes.traffic import read
from mecarover_fakes.traffic import read_register
from mecarover_fakes.traffic import write
from mecarover_fakes.traffic import write_register
from mecarover_fakes.values import VOLTAGE
from msg_defs.dxl1_instruction import CALIBRATE

FACTORY_ID = 1
LAST_ID = 253
CODE_OF_TWO_MEANINGS = 5
OLD_MINOR, NEW_MINOR = 9, 10
SCS_LOCK = 48                    # in the SCS series; half of Torque Limit in an STS
LOW_MAXIMUM = 80                 # Max Voltage Limit of a 7.4 V servo of Feetech, 0.1 V
LOW_SUPPLY = 7.4
TOO_MUCH = 1.5                   # times the limit, as 12 V on a servo for up to 8 V


class Once(Effect):
    """What the master does one time."""

    def begin(self, now: int) -> None:
        self._done = False

    def asks(self, cycle: int) -> Iterable[Ask]:
        if self._done:
            return ()
        self._done = True
        return self.first()

    def first(self) -> Iterable[Ask]:
        """Return what the master asks, once."""
        return ()


class Baud(Once):
    """The master writes Baud Rate of the device, which is never heard again."""

    def first(self) -> Iterable[Ask]:
        if self.device.field('Baud Rate') is not None:
            yield from write_register(self.device, 'Torque Enable', b'\x00')
            yield from write_register(self.device, 'Baud Rate', bytes([self.code()]))

    def code(self) -> int:
        """Return what is written."""
        codes = self.device.baud_codes
        return next(code for code, baud in codes.items() if baud != self.line.baud)


class BaudCode(Baud):
    """The master writes a baud code that Feetech and LeRobot read differently."""

    def code(self) -> int:
        return CODE_OF_TWO_MEANINGS


class FactoryId(Effect):
    """The device still has the factory ID 1, which another device was given."""

    exact = False

    def begin(self, now: int) -> None:
        self._own = {device: device.id for device in self.devices}
        for device in self._own:
            self.line.renumber(device, FACTORY_ID)

    def end(self, now: int) -> None:
        for device, number in self._own.items():
            self.line.renumber(device, number)


class LastId(Effect):
    """The master asks ID 253, where nothing is."""

    exact = False                # in Protocol 2.0 no device can be missed there

    def asks(self, cycle: int) -> Iterable[Ask]:
        if cycle % 20 == 0:
            yield read(LAST_ID, 3, 2)


class MixedFirmware(Once):
    """The device has an older firmware than the others; the master reads that of all."""

    def begin(self, now: int) -> None:
        super().begin(now)
        affected = self.device
        for device in self.line.chain:
            device.set('Firmware Version Minor', OLD_MINOR if device is affected else NEW_MINOR)

    def first(self) -> Iterable[Ask]:
        return [read(device.id, 0, 2) for device in self.line.chain]


class Locked(Once):
    """The master writes EEPROM while Lock is 1."""

    def begin(self, now: int) -> None:
        super().begin(now)
        self.device.set('Lock', 1)

    def first(self) -> Iterable[Ask]:
        yield from read_register(self.device, 'Lock')
        yield from write_register(self.device, 'Temperature Limit', b'\x46')


class Calibrated(Once):
    """The master calibrates the device twice, by the instruction."""

    def first(self) -> Iterable[Ask]:
        return [Ask(self.device.id, CALIBRATE)] * 2


class Middle(Once):
    """The master calibrates the device twice, by Torque Enable 128."""

    def first(self) -> Iterable[Ask]:
        return list(write_register(self.device, 'Torque Enable', bytes([MIDDLE]))) * 2


class Offset(Once):
    """The master calibrates the device on top of the offset that it has."""

    def first(self) -> Iterable[Ask]:
        offset = self.device.field('Homing Offset')
        if offset is not None:
            yield write(self.device.id, offset.at, offset.bytes_of(120))
            yield from read_register(self.device, 'Present Position')
            yield write(self.device.id, offset.at, offset.bytes_of(95))


class ForeignLayout(Effect):
    """The master uses the table of another series: Lock of an SCS servo, on an STS."""

    def asks(self, cycle: int) -> Iterable[Ask]:
        if cycle % 20 == 0:
            yield write(self.device.id, SCS_LOCK, b'\x01')


class HighSupply(Hot):
    """The servo is made for a lower voltage: its limit is far below the supply."""

    def begin(self, now: int) -> None:
        for device in self.devices:
            if device.model.protocol == 'feetech':
                device.set('Max Voltage Limit', LOW_MAXIMUM)
            device.voltage = TOO_MUCH * device.get('Max Voltage Limit') / 10
            device.latch(_VOLTAGE, now)

    def end(self, now: int) -> None:
        for device in self.devices:
            _recover(device, now)


class LowSupply(HighSupply):
    """A servo for 12 V on a supply of 7.4 V."""

    def begin(self, now: int) -> None:
        for device in self.devices:
            device.voltage = LOW_SUPPLY


def _recover(device: FakeDevice, now: int) -> None:
    device.voltage = VOLTAGE
    device.restart(now)


_VOLTAGE = 0x01                  # the bit in the error byte, in both dialects
