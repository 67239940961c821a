# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What a rule of the doctor is: data and a pure function from a Case to claims.

A claim names a cause; a doubt says that the evidence is there and does not decide. Neither knows
of time before the case: how long a claim lasts is the Doctor's.
"""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterable
from collections.abc import Iterator
from collections.abc import Mapping
from collections.abc import Set
from dataclasses import dataclass
from dataclasses import replace
from inspect import getdoc
from inspect import signature
from math import log
from typing import Any
from typing import NamedTuple

from msg_defs.diagnostics import Level
from servobus.bus.report import IncidentKind
from servobus.doctor.symptom import PROOF
from servobus.doctor.symptom import Symptom

ANSWER = 'answer'                  # for `rests_on`: the last answer to any instruction
FAMILY_1 = ('1', 'feetech')        # as model files call the protocols of the 1.0 family
PORT = 'PORT'                      # in a step: the port, where its name is put in
STOP_OTHERS = f'stop all other programs (`fuser -v {PORT}`) and listen again'


class Claim(NamedTuple):
    """
    A cause found; device None = the bus. covers: devices with trouble of this cause.

    rests_on: the register of these devices whose value it is about, or ANSWER; then registers that
    decide what the value means. It does not end while the first is not seen again (standing.py).
    """

    message: str
    figures: Mapping[str, object] = {}
    level: Level | None = None     # where it is not the rule's
    covers: tuple[int, ...] = ()
    is_certain: bool = False       # it needs no onset
    stands_alone: bool = False     # it explains no other claim
    device: int | None = None
    rests_on: tuple[str, ...] = ()

    @property
    def evidence(self) -> tuple[tuple[str, str], ...]:
        """The figures as a finding has them."""
        return tuple((name, str(figure)) for name, figure in self.figures.items())


class Doubt(NamedTuple):
    """
    Something is wrong or unknown, and the evidence does not say what.

    step: what decides between the causes in the reason, where a user would call it broken. Without
    one it is a lack of information, which changes no exit code.
    """

    reason: str
    device: int | None = None
    step: str = ''


_STEPS_PERCENT = (0.2, 0.5, 1, 2, 5, 10, 20, 50, 100)
_STEPS_S = (1, 5, 10, 30, 60, 300, 600, 1800, 3600)

Found = Claim | Doubt
Claims = Iterator[Found]


@dataclass(frozen=True, eq=False)
class Rule:
    """
    One cause: a decorator of the check that finds it, which has its name.

    The docstring of the check is its row in docs/doctor.md: what is seen, and what to do.
    accounts_for: symptoms that follow, of the device of a claim and those that it covers, and of
    the bus; those of all devices, where it is about the bus.
    """

    symptoms: Set[Symptom] = PROOF         # what its findings consist of
    accounts_for: Set[Symptom] = frozenset()
    subject: str = 'device'        # or 'bus', or both
    level: Level = Level.WARN
    onset_s: float = 0.0           # claimed without a break for so long, before it is reported
    holds: bool = True             # lasts some seconds longer than its evidence; a state does not
    # What it is asked of: all, or where there are such incidents, values of these registers,
    # models of these protocols, a model that was named: the registers alone may be known by what
    # the program uses.
    needs_incident: tuple[IncidentKind[Any], ...] = ()
    needs_registers: Set[str] = frozenset()
    protocols: tuple[str, ...] = ()
    needs_model: bool = False
    # Set by the decorator. name: as in the key finding.<name>; check: from a case to what is
    # found, or from a case and a device to what is found of that, or None.
    name: str = ''
    check: Callable[..., Any] = iter
    each_device: bool = False

    @property
    def advice(self) -> tuple[str, str]:
        """What is seen, and what to do."""
        text = ' '.join((getdoc(self.check) or '').split()).removesuffix('.')
        seen, _, remedy = text.partition('. Do: ')
        return seen, remedy

    def __call__(self, check: Callable[..., Any]) -> Rule:
        """Return the rule with its check."""
        return replace(self, name=check.__name__, check=check,
                       each_device=len(signature(check).parameters) > 1)


def share(part: float, whole: float) -> str:
    """Spell a share: '12 %'."""
    percent = 100 * part / whole if whole else 0.0
    return f'{percent:.0f} %' if percent >= 9.95 else f'{percent:.1f} %'


def about(part: float, whole: float) -> str:
    """Spell a share in steps, so that the words stand still: 'about 5 %'."""
    percent = 100 * part / whole if whole else 0.0
    nearest = min(_STEPS_PERCENT, key=lambda step: abs(log(step / max(percent, 0.05))))
    least = _STEPS_PERCENT[0]
    return f'about {nearest:g} %' if percent > least else f'less than {least:g} %'


def longer_than(seconds: float) -> str:
    """Spell a time in steps, so that the words stand still: 'more than 10 s'."""
    step = max((one for one in _STEPS_S if one <= seconds), default=1)
    return f'more than {step} s' if step < 60 else f'more than {step // 60} min'


def all_ids(numbers: Iterable[int]) -> str:
    """Spell all IDs, for a figure: '003, 004'."""
    return ', '.join(_ids(numbers))


def first_ids(numbers: Iterable[int], most: int = 6, total: int = 0) -> str:
    """Spell IDs: '003, 004 and 9 more', or 'all 11' where that is the total."""
    ids = _ids(numbers)
    count = len(ids)
    if most < count == total:
        return f'all {total}'
    more = f' and {count - most} more' if count > most else ''
    return ', '.join(ids[:most]) + more


def _ids(numbers: Iterable[int]) -> list[str]:
    return [f'{number:03}' for number in numbers]
