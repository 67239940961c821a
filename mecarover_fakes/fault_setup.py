# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Faults of servos that were not set up for this robot, or wrongly; mostly of the 1.0 family."""

from __future__ import annotations

from mecarover_fakes.dxl1_servo import MIDDLE
from mecarover_fakes.fake_servo import FakeDevice
from mecarover_fakes.fault import Effect
from mecarover_fakes.fault import FAMILY_1
from mecarover_fakes.fault import Play
from mecarover_fakes.fault_device import BeyondLimits
from mecarover_fakes.traffic import Ask
from mecarover_fakes.traffic import Asks
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
VOLTAGE_BIT = 0x01               # in the error byte, in both dialects
ONLY_FEETECH = ('feetech',)


class Baud(Effect):
    """The master writes Baud Rate of the device, which is never heard again."""

    every = 0

    def ask(self) -> Asks:
        if self.device.field('Baud Rate') is not None:
            yield from write_register(self.device, 'Torque Enable', b'\x00')
            yield from write_register(self.device, 'Baud Rate', bytes([self.code()]))

    def code(self) -> int:
        """Return what is written."""
        codes = self.device.baud_codes
        return next(code for code, baud in codes.items() if baud != self.line.baud)


class BaudCode(Baud):
    """The master writes a baud code that Feetech and LeRobot read differently."""

    protocols = ONLY_FEETECH

    def code(self) -> int:
        return CODE_OF_TWO_MEANINGS


class FactoryId(Effect):
    """The device still has the factory ID 1, which another device was given."""

    def affect_device(self, device: FakeDevice) -> Play:
        number = device.id
        device.renumber(FACTORY_ID)
        yield
        device.renumber(number)


class LastId(Effect):
    """The master asks ID 253, where nothing is."""

    every = 20                   # in Protocol 2.0 no device can be missed there

    def ask(self) -> Asks:
        yield read(LAST_ID, 3, 2)


class MixedFirmware(Effect):
    """The device has an older firmware than the others; the master reads that of all."""

    protocols = ONLY_FEETECH
    every = 0

    def play(self) -> Play:
        affected = self.device
        for device in self.line.chain:
            device.set('Firmware Version Minor', OLD_MINOR if device is affected else NEW_MINOR)
        yield

    def ask(self) -> Asks:
        return [read(device.id, 0, 2) for device in self.line.chain]


class Locked(Effect):
    """The master writes EEPROM while Lock is 1."""

    protocols = FAMILY_1
    every = 0

    def play(self) -> Play:
        self.device.set('Lock', 1)
        yield

    def ask(self) -> Asks:
        yield from read_register(self.device, 'Lock')
        yield from write_register(self.device, 'Temperature Limit', b'\x46')


class Calibrated(Effect):
    """The master calibrates the device twice, by the instruction."""

    protocols = ONLY_FEETECH
    every = 0

    def ask(self) -> Asks:
        return [Ask(self.device.id, CALIBRATE)] * 2


class Middle(Effect):
    """The master calibrates the device twice, by Torque Enable 128."""

    protocols = ONLY_FEETECH
    every = 0

    def ask(self) -> Asks:
        return list(write_register(self.device, 'Torque Enable', bytes([MIDDLE]))) * 2


class Offset(Effect):
    """The master calibrates the device on top of the offset that it has."""

    protocols = ONLY_FEETECH
    every = 0

    def ask(self) -> Asks:
        offset = self.device.field('Homing Offset')
        if offset is not None:
            yield write(self.device.id, offset.at, offset.bytes_of(120))
            yield from read_register(self.device, 'Present Position')
            yield write(self.device.id, offset.at, offset.bytes_of(95))


class Layout(Effect):
    """The master uses the table of another series: Lock of an SCS servo, on an STS."""

    protocols = ONLY_FEETECH
    every = 20

    def ask(self) -> Asks:
        yield write(self.device.id, SCS_LOCK, b'\x01')


class HighSupply(BeyondLimits):
    """The servo is made for a lower voltage: its limit is far below the supply."""

    protocols = FAMILY_1

    def affect_device(self, device: FakeDevice) -> Play:
        if device.model.protocol == 'feetech':
            device.set('Max Voltage Limit', LOW_MAXIMUM)
        device.voltage = TOO_MUCH * device.get('Max Voltage Limit') / 10
        device.latch(VOLTAGE_BIT, self.now)
        yield
        device.voltage = VOLTAGE
        device.restart(self.now)


class LowSupply(HighSupply):
    """A servo for 12 V on a supply of 7.4 V."""

    def affect_device(self, device: FakeDevice) -> Play:
        device.voltage = LOW_SUPPLY
        yield
        device.voltage = VOLTAGE
        device.restart(self.now)
