# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Faults of the simulated bus that sit in a device or in its supply."""

from __future__ import annotations

from collections.abc import Iterable

from mecarover_fakes.fake_servo import FakeDevice
from mecarover_fakes.fault import Effect
from mecarover_fakes.fault import Fault
from mecarover_fakes.fault import FaultScope
from mecarover_fakes.fault import MS
from mecarover_fakes.traffic import Ask
from mecarover_fakes.traffic import read
from mecarover_fakes.traffic import read_register
from mecarover_fakes.traffic import sync_read
from mecarover_fakes.traffic import write
from mecarover_fakes.values import Sine
from mecarover_fakes.values import TEMPERATURE
from mecarover_fakes.values import VOLTAGE
from msg_defs.dxl_instruction import Instruction

DIP_NS = 600 * MS                # low voltage before a brown-out
BOOT_NS = 400 * MS
OVERLOAD = 0x20
FACTORY_DELAY = 250
WATCHDOG = 5                     # units of 20 ms
OLD_FIRMWARE = 40


class Silent(Effect):
    """The device hears and says nothing."""

    def begin(self, now: int) -> None:
        self._gone = self.affected()
        for device in self._gone:
            device.silent = True

    def end(self, now: int) -> None:
        for device in self._gone:
            device.silent = False

    def affected(self) -> list[FakeDevice]:
        """Return who is cut off."""
        return [self.device]


class Cable(Silent):
    """The cable to the device is broken: it and everything downstream are gone."""

    def affected(self) -> list[FakeDevice]:
        return self.line.chain[self.line.chain.index(self.device):]


class Duplicate(Effect):
    """A second device with the same ID, on its own return delay and perhaps another model."""

    exact = False

    def __init__(self, fault: Fault, scene: FaultScope) -> None:
        super().__init__(fault, scene)
        original = self.device
        others = [device.model for device in self.line.chain
                  if device.model is not original.model and device.field('Torque Enable')]
        self.twin = type(original)(original.id, (others or [original.model])[0],
                                   baud=self.line.baud, motion=Sine(phase=2.0))

    def begin(self, now: int) -> None:
        self.line.add(self.twin)

    def end(self, now: int) -> None:
        self.line.remove(self.twin)

    def step(self, now: int) -> None:
        # Sometimes on top of the other's answer, sometimes after it.
        self.twin.set('Return Delay Time', self.rng.choice((5, FACTORY_DELAY)))


class Reboot(Effect):
    """The device starts again by itself."""

    def begin(self, now: int) -> None:
        for device in self.devices:
            device.restart(now, BOOT_NS)


class Brownout(Reboot):
    """The supply sags, then the device starts again."""

    def begin(self, now: int) -> None:
        self._at: int | None = now + DIP_NS
        for device in self.devices:
            device.voltage = VOLTAGE * 0.7

    def step(self, now: int) -> None:
        if self._at is not None and now >= self._at:
            self._at = None
            for device in self.devices:
                device.restart(now, BOOT_NS)
                device.voltage = VOLTAGE


class Latched(Effect):
    """Overload latched: alert on every status, motor off; the end of the fault is a restart."""

    def begin(self, now: int) -> None:
        for device in self.devices:
            device.latch(OVERLOAD, now)

    def end(self, now: int) -> None:
        for device in self.devices:
            device.restart(now)


class ReturnDelay(Effect):
    """Return Delay Time is still the factory's 500 us."""

    def begin(self, now: int) -> None:
        for device in self.devices:
            device.set('Return Delay Time', FACTORY_DELAY)

    def end(self, now: int) -> None:
        for device in self.devices:
            device.set('Return Delay Time', 0)


class NoAck(Effect):
    """Status Return Level 1: reads are answered, writes are not."""

    level = 1

    def begin(self, now: int) -> None:
        for device in self.devices:
            device.answer_level(self.level)

    def end(self, now: int) -> None:
        for device in self.devices:
            device.answer_level(2)

    def asks(self, cycle: int) -> Iterable[Ask]:
        count = len(self.line.chain)
        for device in self.devices:
            led = device.field('LED') or device.field('Acceleration')
            if led is not None and cycle % count == device.id % count:
                yield write(device.id, led.at, bytes(led.size))
                self.scene.pace.pause = self.scene.pace.patience     # it waits for an answer
                yield Ask(device.id, Instruction.PING)


class PingOnly(NoAck):
    """Status Return Level 0: only Pings are answered."""

    exact = False                # a listener cannot know why it does not answer reads
    level = 0


class OldFirmware(Effect):
    """Firmware from before the fast reads, asked by a master that uses them."""

    def begin(self, now: int) -> None:
        for device in self.devices:
            device.firmware = OLD_FIRMWARE
            device.set('Firmware Version', OLD_FIRMWARE)

    def asks(self, cycle: int) -> Iterable[Ask]:
        if cycle % 5 == 0:
            yield from (Ask(device.id, Instruction.PING) for device in self.devices)
            for span in self.scene.fleet.spans('Present Position'):
                yield from sync_read(span)
                yield from sync_read(span, Instruction.FAST_SYNC_READ)


class Hot(Effect):
    """The motor is warmer than its own limit."""

    def begin(self, now: int) -> None:
        for device in self.devices:
            device.temperature = device.get('Temperature Limit', 80) + 2.0

    def end(self, now: int) -> None:
        for device in self.devices:
            device.temperature = TEMPERATURE

    def asks(self, cycle: int) -> Iterable[Ask]:
        if cycle % 50 == 0:
            for name in ('Temperature Limit', 'Min Voltage Limit', 'Max Voltage Limit'):
                for device in self.devices:
                    yield from read_register(device, name)


class LowVoltage(Hot):
    """The supply is below the device's own limit."""

    def begin(self, now: int) -> None:
        for device in self.devices:
            device.voltage = device.get('Min Voltage Limit', 95) / 10 - 0.5

    def end(self, now: int) -> None:
        for device in self.devices:
            device.voltage = VOLTAGE


class Watchdog(Effect):
    """The master sets a Bus Watchdog, falls silent for too long, and finds its goals refused."""

    def begin(self, now: int) -> None:
        self._armed = False
        self._field = self.device.field('Bus Watchdog')
        self._goal = self.device.field('Goal Position')

    def asks(self, cycle: int) -> Iterable[Ask]:
        if self._field is None or self._goal is None:
            return
        number = self.device.id
        if not self._armed:
            self._armed = True
            yield write(number, self._field.at, bytes([WATCHDOG]))
            self.scene.pace.pause = 3 * WATCHDOG * 20 * MS
        yield write(number, self._goal.at,
                    bytes(self.device.image[self._goal.at:self._goal.end]))
        if cycle % 20 == 0:
            yield read(number, self._field.at, 1)


class Late(Effect):
    """The device answers when the master has given up."""

    exact = False

    def begin(self, now: int) -> None:
        self.device.extra_delay_ns = self.scene.pace.patience + 2 * MS

    def end(self, now: int) -> None:
        self.device.extra_delay_ns = 0


class Unwritten(Effect):
    """The master polls the device and never writes to it."""

    def begin(self, now: int) -> None:
        self.scene.fleet.unwritten.add(self.device.id)

    def end(self, now: int) -> None:
        self.scene.fleet.unwritten.discard(self.device.id)
