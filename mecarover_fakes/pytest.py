# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Fixtures for tests of a program that drives servos: `pytest_plugins = ['mecarover_fakes.pytest']`.

No entry point: pytest loads them only where a conftest.py asks for them.
"""
from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterator
from collections.abc import Sequence
from contextlib import ExitStack
from typing import Any

import pytest

from mecarover_fakes.bus_ptys import FakeBus
from mecarover_fakes.fake_bus import make_devices
from mecarover_fakes.fake_bus import make_line
from mecarover_fakes.fake_bus import PROTOCOLS
from mecarover_fakes.faults import parse as parse_fault
from mecarover_fakes.master import Master
from mecarover_fakes.traffic import PATTERNS
from servobus import Level
from servobus import listen
from servobus import Listening
from servobus import Models
from servobus import ParameterError

_RAISED = pytest.StashKey[BaseException]()


def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> None:
    """Keep what a test raised: the last question before that may be the reason."""
    if call.when == 'call' and call.excinfo is not None:
        item.stash[_RAISED] = call.excinfo.value


@pytest.fixture
def servo_bus() -> Iterator[Callable[..., FakeBus]]:
    """
    Return a function that starts a simulated bus on a pty; the port to open is its `path`.

    servo_bus('1-6:STS3215', dialect='feetech', baud=1_000_000, faults=['silent:3']): devices and
    faults as of fake_bus (docs/simulation.md); dialect: '2', 'dxl1' or 'feetech'; baud in bit/s.
    """
    with ExitStack() as stack:
        def start(*devices: str, dialect: str = '2', baud: int = 1_000_000,
                  faults: Sequence[str] = ()) -> FakeBus:
            if dialect not in PROTOCOLS:
                raise ParameterError(f'dialect: there is no {dialect!r}; '
                                     f'use one of {", ".join(PROTOCOLS)}')
            if isinstance(faults, str):
                raise ParameterError(f'faults: write a list: [{faults!r}]')
            made = make_devices(list(devices), Models(), baud, moving=False, dialect=dialect)
            bus = FakeBus(Master(make_line(made, baud, dialect), PATTERNS['none'],
                                 faults=[parse_fault(text) for text in faults]))
            bus.start()
            stack.callback(bus.stop)
            return bus

        yield start


@pytest.fixture
def servo_doctor(request: pytest.FixtureRequest) -> Iterator[Callable[..., Listening]]:
    """
    Return a function that listens to a port; the test fails for what it finds at WARN or above.

    servo_doctor(serial_port, devices=['1-6:STS3215']): arguments of servobus.listen().
    """
    listening: list[Listening] = []
    stack = ExitStack()

    def begin(port: Any, **options: Any) -> Listening:
        listening.append(stack.enter_context(listen(port, **options)))
        return listening[-1]

    yield begin
    raised = request.node.stash.get(_RAISED, None)
    # As if the test had been inside `with listen()`: a Listening looks at what was raised there.
    stack.__exit__(type(raised) if raised else None, raised, None)
    wrong = [f'{one.level.name} {one.rule}, {one.who}: {one.message}'
             for bus in listening for one in bus.findings if one.level >= Level.WARN]
    if wrong:
        pytest.fail('\n'.join(['the servo bus is not well:', *wrong]), pytrace=False)
