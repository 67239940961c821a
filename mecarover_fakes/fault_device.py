# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Faults of the simulated bus that sit in a device or in its supply."""

from __future__ import annotations

from mecarover_fakes.fake_servo import FakeDevice
from mecarover_fakes.fault import Effect
from mecarover_fakes.fault import ONLY_2
from mecarover_fakes.fault import Play
from mecarover_fakes.traffic import Ask
from mecarover_fakes.traffic import Asks
from mecarover_fakes.traffic import read_register
from mecarover_fakes.traffic import sync_read
from mecarover_fakes.traffic import write
from mecarover_fakes.traffic import write_register
from mecarover_fakes.values import Sine
from mecarover_fakes.values import TEMPERATURE
from mecarover_fakes.values import VOLTAGE
from msg_defs.dxl_instruction import Instruction
from msg_defs.nanoseconds import NS_PER_MS

DIP_NS = 600 * NS_PER_MS         # low voltage before a brown-out
BOOT_NS = 400 * NS_PER_MS
OVERLOAD = 0x20
FACTORY_DELAY = 250
WATCHDOG = 5                     # units of 20 ms
OLD_FIRMWARE = 40


class Silent(Effect):
    """The device hears and says nothing."""

    @property
    def devices(self) -> list[FakeDevice]:
        """The devices that are cut off."""
        return [self.device]

    def affect_device(self, device: FakeDevice) -> Play:
        device.silent = True
        yield
        device.silent = False


class Cable(Silent):
    """The cable to the device is broken: it and everything downstream are gone."""

    @property
    def devices(self) -> list[FakeDevice]:
        """The device and what is downstream."""
        return self.line.chain[self.line.chain.index(self.device):]


class Duplicate(Effect):
    """A second device with the same ID, on its own return delay and perhaps another model."""

    def play(self) -> Play:
        original = self.device
        others = [device.model for device in self.line.chain
                  if device.model is not original.model and device.field('Torque Enable')]
        self.twin = type(original)(original.id, (others or [original.model])[0],
                                   baud=self.line.baud, motion=Sine(phase=2.0))
        self.line.chain.append(self.twin)
        yield
        self.line.chain.remove(self.twin)

    def step(self) -> None:
        # Sometimes on top of the other's answer, sometimes after it.
        self.twin.set('Return Delay Time', self.rng.choice((5, FACTORY_DELAY)))


class Reboot(Effect):
    """The device starts again by itself."""

    def affect_device(self, device: FakeDevice) -> Play:
        device.restart(self.now, BOOT_NS)
        yield


class Brownout(Effect):
    """The supply sags, then the device starts again."""

    def play(self) -> Play:
        self._low_until = self.now + DIP_NS
        self._low = self.devices
        for device in self._low:
            device.voltage = VOLTAGE * 0.7
        yield
        self._rise()

    def step(self) -> None:
        if self.now >= self._low_until:
            self._rise()

    def _rise(self) -> None:
        low, self._low = self._low, []
        for device in low:
            device.restart(self.now, BOOT_NS)
            device.voltage = VOLTAGE


class Latched(Effect):
    """Overload latched: alert on every status, motor off; the end of the fault is a restart."""

    def affect_device(self, device: FakeDevice) -> Play:
        device.latch(OVERLOAD, self.now)
        yield
        device.restart(self.now)


class ReturnDelay(Effect):
    """Return Delay Time is still the factory's 500 us."""

    def affect_device(self, device: FakeDevice) -> Play:
        device.set('Return Delay Time', FACTORY_DELAY)
        yield
        device.set('Return Delay Time', 0)


class NoAck(Effect):
    """Status Return Level 1: reads are answered, writes are not."""

    level = 1

    def affect_device(self, device: FakeDevice) -> Play:
        device.answer_level(self.level)
        yield
        device.answer_level(2)

    def ask(self) -> Asks:
        count = len(self.line.chain)
        for device in self.devices:
            led = device.field('LED') or device.field('Acceleration')
            if led is not None and self.cycle % count == device.id % count:
                yield write(device.id, led.at, bytes(led.size))
                self.timing.pause = self.timing.patience     # it waits for an answer
                yield Ask(device.id, Instruction.PING)


class PingOnly(NoAck):
    """Status Return Level 0: only Pings are answered."""

    protocols = ('2', '1')
    level = 0                    # a listener cannot know why it does not answer reads


class OldFirmware(Effect):
    """Firmware from before the fast reads, asked by a master that uses them."""

    protocols = ONLY_2
    every = 5

    def affect_device(self, device: FakeDevice) -> Play:
        device.firmware = OLD_FIRMWARE
        device.set('Firmware Version', OLD_FIRMWARE)
        yield

    def ask(self) -> Asks:
        yield from (Ask(device.id, Instruction.PING) for device in self.devices)
        for span in self.fleet.spans('Present Position'):
            yield from sync_read(span)
            yield from sync_read(span, Instruction.FAST_SYNC_READ)


class BeyondLimits(Effect, is_fault=False):
    """Something is beyond the device's own limits, which the master reads now and then."""

    every = 50

    def ask(self) -> Asks:
        for name in ('Temperature Limit', 'Min Voltage Limit', 'Max Voltage Limit'):
            for device in self.devices:
                yield from read_register(device, name)


class Hot(BeyondLimits):
    """The motor is warmer than its own limit."""

    def affect_device(self, device: FakeDevice) -> Play:
        device.temperature = device.get('Temperature Limit', 80) + 2.0
        yield
        device.temperature = TEMPERATURE


class LowVoltage(BeyondLimits):
    """The supply is below the device's own limit."""

    def affect_device(self, device: FakeDevice) -> Play:
        device.voltage = device.get('Min Voltage Limit', 95) / 10 - 0.5
        yield
        device.voltage = VOLTAGE


class Watchdog(Effect):
    """The master sets a Bus Watchdog, falls silent for too long, and finds its goals refused."""

    protocols = ONLY_2
    is_armed = False

    def ask(self) -> Asks:
        goal = self.device.field('Goal Position')
        if goal is None or self.device.field('Bus Watchdog') is None:
            return
        if not self.is_armed:
            self.is_armed = True
            yield from write_register(self.device, 'Bus Watchdog', bytes([WATCHDOG]))
            self.timing.pause = 3 * WATCHDOG * 20 * NS_PER_MS
        yield write(self.device.id, goal.at, self.device.bytes_in(goal))
        if self.cycle % 20 == 0:
            yield from read_register(self.device, 'Bus Watchdog')


class Late(Effect):
    """The device answers when the master has given up."""

    def play(self) -> Play:
        self.device.extra_delay_ns = self.timing.patience + 2 * NS_PER_MS
        yield
        self.device.extra_delay_ns = 0


class Unwritten(Effect):
    """The master polls the device and never writes to it."""

    def play(self) -> Play:
        self.fleet.unwritten.add(self.device.id)
        yield
        self.fleet.unwritten.discard(self.device.id)
