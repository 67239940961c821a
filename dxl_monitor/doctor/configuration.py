# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Rules about what the master's program does wrong, or how the devices are set up."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from dxl_monitor import evidence as ev
from dxl_monitor.doctor.case import Case
from dxl_monitor.doctor.rule import Claim
from dxl_monitor.doctor.rule import Doubt
from dxl_monitor.doctor.rule import each
from dxl_monitor.doctor.rule import each_with
from dxl_monitor.doctor.rule import Found
from dxl_monitor.doctor.rule import listed
from dxl_monitor.doctor.rule import Rule
from dxl_monitor.report import DeviceReport
from msg_defs.dxl_instruction import error_text
from msg_defs.dxl_instruction import Instruction
from msg_defs.dxl_instruction import name_of
from msg_defs.reports import Level

S = 1_000_000_000
FEW = 3
RANGE, LENGTH, ACCESS, UNKNOWN_TO_IT = 4, 5, 7, 2
WORN = 30                          # EEPROM writes in 10 s: no start-up writes as many
POLLED = 20                        # reads of a device that was never written
POLLED_S = 3.0
ACKS_LEARNED = 3
FAST = (Instruction.FAST_SYNC_READ, Instruction.FAST_BULK_READ)
ALWAYS_CUT = 0.8

# Addresses of other series that programs use by mistake (e-Manual, PRO): what stands there.
_PRO = {562: 'Torque Enable', 596: 'Goal Position', 600: 'Goal Velocity', 604: 'Goal Torque',
        611: 'Present Position', 615: 'Present Velocity'}


def _refused(case: Case, device: DeviceReport) -> Counter[tuple[int, int, int]]:
    """Return (instruction, address, error) of what it refused in the window."""
    return Counter((one.detail[0], one.detail[1], one.detail[2])
                   for one in case.incidents(ev.REFUSED, device.id))


def _is_locked(device: DeviceReport, address: int, error: int) -> bool:
    field = device.model.by_address.get(address)
    return error == ACCESS and field is not None and field.memory == 'eeprom' \
        and 'w' in field.access


def _eeprom_locked(case: Case, device: DeviceReport) -> Found | None:
    torque = case.values[device.id].get('Torque Enable')
    for (instruction, address, error), count in _refused(case, device).items():
        writes = instruction in (Instruction.WRITE, Instruction.REG_WRITE)
        if count >= FEW and writes and _is_locked(device, address, error) \
                and (torque is None or torque.value.raw):
            name = device.model.by_address[address].name
            return Claim(device.id, f'write to {name} ({address}) refused {count} times: EEPROM '
                         'takes no writes while the torque is on; switch it off first',
                         (('refused', str(count)),))
    return None


def _wrong_address(case: Case, device: DeviceReport) -> Found | None:
    found: Counter[tuple[int, int]] = Counter()
    for (_, address, error), count in _refused(case, device).items():
        if error in (ACCESS, LENGTH, RANGE) and not _is_locked(device, address, error):
            found[address, error] += count
    for (address, error), count in found.most_common(1):
        if count >= FEW:
            return Claim(device.id, f'address {address} refused {count} times '
                         f'({error_text(error)}): {_what_is_there(device, address, error)}',
                         (('refused', str(count)),))
    return None


def _what_is_there(device: DeviceReport, address: int, error: int) -> str:
    field = device.model.by_address.get(address)
    if address in _PRO and (field is None or field.name != _PRO[address]):
        return f'{_PRO[address]} of the PRO series; use the control table of {device.model_name}'
    if field is None:
        return f'{device.model_name} has no register there; check the control table in use'
    if error == RANGE:
        return f'the value is out of the range of {field.name}; limit it'
    return f'{field.name} ({field.access}, {field.size} bytes) cannot be used like that'


def _eeprom_wear(case: Case, device: DeviceReport) -> Found | None:
    count = device.window.eeprom_writes
    if count < WORN:
        return None
    hours = 100_000 / (count / 10) / 3600
    return Claim(device.id, f'EEPROM written {count} times in 10 s: it lasts some 100 000 writes, '
                 f'{hours:.1f} hours at this rate; write only what changes',
                 (('writes in 10 s', str(count)),))


def _no_acks(case: Case, device: DeviceReport) -> Found | None:
    unanswered = case.count(ev.ACKS_STOPPED, device.id) or device.acks_missing >= ACKS_LEARNED
    if device.acks and not unanswered:
        return None
    if not unanswered and device.status_return_level not in (0, 1):
        return None
    level = device.status_return_level
    return Claim(device.id, f'acknowledges no writes (Status Return Level {level or "below 2"}): '
                 'a master that waits for it loses a time-out each; use Sync Write or level 2')


def _fast_reads(case: Case) -> Iterator[Found]:
    if any(cycle.instruction in FAST for cycle in case.report.cycles):
        yield from each(_fast_read)(case)


def _fast_read(case: Case, device: DeviceReport) -> Found | None:
    cuts = case.incidents(ev.FAST_CUT)
    own = case.count(ev.FAST_CUT, device.id)
    missed = sum(one.detail[0] in FAST for one in case.incidents(ev.MISSED, device.id))
    refused = sum(one.detail[0] in FAST and one.detail[2] == UNKNOWN_TO_IT
                  for one in case.incidents(ev.REFUSED, device.id))
    failing = own if cuts and own >= ALWAYS_CUT * len(cuts) else 0
    count = max(failing, refused, 0 if cuts else missed)
    if count < FEW or not device.window.answers or not _never_fast(case, device):
        return None
    firmware = '' if device.firmware is None else f', firmware {device.firmware}'
    return Claim(device.id, f'answers, but no fast reads ({device.model_name}{firmware}): update '
                 'it or use plain Sync Read; devices behind it get no turn',
                 (('fast reads failed', str(count)),))


def _never_fast(case: Case, device: DeviceReport) -> bool:
    """Tell whether no fast read that names it has succeeded lately."""
    for cycle in case.report.cycles:
        if cycle.instruction in FAST and device.id in cycle.ids and cycle.stamps:
            fails = len(case.incidents(ev.FAST_CUT)) + case.count(ev.MISSED, device.id)
            recent = sum(stamp > case.now - 2 * S for stamp in cycle.stamps)
            if fails < min(recent, FEW):
                return False
    return True


def _unstuffed(case: Case) -> Iterator[Found]:
    notes = case.incidents(ev.UNSTUFFED)
    if notes:
        last = notes[-1]
        yield Claim(None, f'the master does not stuff FF FF FD in what it sends '
                    f'({name_of(last.detail[0])} to {last.device:03}), as the Python SDK: a '
                    'device may miss it; mend its library', (('packets', str(len(notes))),))


def _never_written(case: Case, device: DeviceReport) -> Found | None:
    if device.writes or device.reads < POLLED or 'Goal Position' not in device.model.by_name \
            or (case.now - case.report.started) / S < POLLED_S or not device.window.answers:
        return None
    written = [one.id for one in case.report.devices if one.window.writes]
    if not written:
        return Doubt(device.id, 'polled and never written, as all others: perhaps this master '
                     'only looks')
    return Claim(device.id, f'polled {device.reads} times and never written, others are '
                 f'({listed(written, 2)}): forgotten in the program?',
                 (('reads', str(device.reads)),))


RULES = (
    Rule('eeprom_locked', Level.WARN, 'writes to EEPROM answered with Access, torque not known '
         'to be off', each_with(ev.REFUSED, _eeprom_locked)),
    Rule('wrong_address', Level.WARN, 'the same address refused again and again: Access, Data '
         'Length or Data Range', each_with(ev.REFUSED, _wrong_address)),
    Rule('eeprom_wear', Level.WARN, f'{WORN} accepted writes to EEPROM in 10 s',
         each(_eeprom_wear)),
    Rule('fast_read_unsupported', Level.WARN, 'fast reads that end at a device which answers '
         'other instructions', _fast_reads,
         ('noise', 'damaged_answers', 'missed_answers', 'jitter', 'wrong_address')),
    Rule('unstuffed', Level.WARN, 'a whole instruction with FF FF FD and no stuffing behind it',
         _unstuffed),
    Rule('no_acks', Level.OK, 'writes without an acknowledgement from a device that answers reads',
         each(_no_acks), ('missed_answers',)),
    Rule('never_written', Level.OK, 'reads, and no writes while other servos are written',
         each(_never_written)),
)
