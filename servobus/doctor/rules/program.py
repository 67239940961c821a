# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What the program does wrong, or asks of devices that they cannot do."""

from __future__ import annotations

from collections import Counter

from msg_defs.diagnostics import Level
from msg_defs.dxl1_instruction import DYNAMIXEL_1
from msg_defs.dxl1_instruction import FEETECH
from msg_defs.dxl1_instruction import UNDECIDED
from msg_defs.dxl1_packet import HEADER
from msg_defs.dxl_instruction import error_text
from msg_defs.dxl_instruction import Instruction
from msg_defs.dxl_instruction import name_of
from msg_defs.dxl_packet import BROADCAST
from msg_defs.event import HOLDS_LINES
from msg_defs.nanoseconds import NS_PER_S
from servobus.bus import evidence as ev
from servobus.bus.report import BusReport
from servobus.bus.report import CONNECTED
from servobus.bus.report import Cycle
from servobus.bus.report import DeviceReport
from servobus.bus.report import PROTOCOL_2
from servobus.bus.report import RATE_REFUSED
from servobus.doctor.bad_packets import repeated_bad_packet
from servobus.doctor.case import Case
from servobus.doctor.case import Names
from servobus.doctor.facts import ACCESS_ERROR
from servobus.doctor.facts import CRC_ERROR
from servobus.doctor.facts import fatal_wait
from servobus.doctor.facts import INSTRUCTION_ERROR
from servobus.doctor.facts import least_refusals
from servobus.doctor.facts import LENGTH_ERROR
from servobus.doctor.facts import most_refused
from servobus.doctor.facts import RANGE_ERROR
from servobus.doctor.facts import raw_value
from servobus.doctor.facts import SINGLE_WRITES
from servobus.doctor.rule import all_ids
from servobus.doctor.rule import ANSWER
from servobus.doctor.rule import Claim
from servobus.doctor.rule import Claims
from servobus.doctor.rule import Doubt
from servobus.doctor.rule import first_ids
from servobus.doctor.rule import Found
from servobus.doctor.rule import Rule
from servobus.doctor.symptom import DAMAGE
from servobus.doctor.symptom import SILENCE
from servobus.doctor.thresholds import INCIDENTS_MIN
from servobus.doctor.thresholds import LONG_WAIT_MS
from servobus.doctor.thresholds import WINDOW_S
from servobus.model.control_table import UNKNOWN

EEPROM_WRITES_MIN = 30             # in 10 s: no start-up writes as many
POLLED_MIN_READS = 20              # from a device that was never written
POLLED_MIN_S = 3.0                 # by then each is written that will be, and models are known
ACKS_MISSING_MIN = 3               # as the decoder learns that writes are not acknowledged
ACKS_WAIT_MIN_SHARE = 0.05         # share of a cycle; the waits of two lost answers are less
ACKS_ONSET_S = 1.0                 # acknowledgements that get lost come again by then
ANSWERS_OTHERWISE_S = 2.0          # an answer to something else, so lately: it is there
STOPPED_MIN_S = 1.2                # two reports at the usual 2 Hz, and what chunks blur
STOPPED_WARN_S = 10.0              # a shorter pause may be meant
WORKED_MIN_S = 2.5                 # a program that ran so long has stopped; a command is done
_READ_WRONGLY = {ev.STUFFED, ev.SPLIT, ev.TAKEN_FOR, ev.STALE}
_HUNG_UP = {5: 'Input/output error', 6: 'No such device or address', 19: 'No such device'}
UNANSWERED_SESSIONS_MIN = 5              # openings of the port
SPLIT_MIN_SHARE = 0.01             # share of the instructions; a busy computer delays a few
TAKEN_MIN = 5                      # answers
TAKEN_MAX_LATER = 1.5              # as many as are taken: after these it did not ask at once
NO_IDS = (0xFD, 0xFF)
EEPROM_AGE_MAX_S = 2.0             # written again and again: so long ago at most
# Where the model is, which the answer to a Ping of these does not have.
_MODEL_AT = {one.name: one.identity_at for one in (DYNAMIXEL_1, FEETECH)}
_NO_ID = ', which no device can have (0 to 252): correct the ID in its program'
SENT_MIN_BYTES = 30                # three packets
SCAN_MIN_PINGS = 15                # broadcast Pings in 10 s: each needs 0.8 s
SCAN_MIN_SHARE = 0.7               # share of the instructions
FAST_READS = (Instruction.FAST_SYNC_READ, Instruction.FAST_BULK_READ)
GROUP_READS = (Instruction.SYNC_READ, Instruction.BULK_READ)
GROUP_READS_MIN = 5                # unanswered, and as many other answers: no loss by chance
MISSED_ALIKE_MIN_SHARE = 0.9       # share of the missed: a bad plug loses all instructions
COLLIDE_MIN_SHARE = 0.7            # share of the group reads in which an answer is damaged
LOST_MAX_SHARE = 0.2               # share of these that another one misses: no cable of all
HAVE_SYNC_READ = ('STS', 'SMS', 'HLS')
NO_BULK_READ = ('AX', 'RX', 'EX', 'DX')
# Model numbers, and the firmware from which they know fast reads: MX(2.0) never.
_FAST_SINCE = (((30, 311, 321), 256), (range(1190, 1250), 46), (range(1000, 1400), 45),
               (range(2000, 2130), 12))
# Addresses of other series that programs use by mistake (e-Manual), with their registers.
_OTHER_SERIES = {address: (name, series) for series, names in (
    ('PRO', {562: 'Torque Enable', 596: 'Goal Position', 600: 'Goal Velocity',
             604: 'Goal Torque', 611: 'Present Position', 615: 'Present Velocity'}),
    ('P', {512: 'Torque Enable', 552: 'Goal Velocity', 564: 'Goal Position',
           576: 'Present Velocity', 580: 'Present Position'})) for address, name in names.items()}


# --- what it sends and reads ---------------------------------------------------------------------

@Rule(subject='bus',
      symptoms={'unread bytes'},
      accounts_for={*SILENCE, *DAMAGE, 'hasty instructions', 'late answers',
                    'absence of several', 'damaged first bytes', 'silent bus', 'unasked answers',
                    'no acknowledgements', 'wrong length', 'restart', 'slow cycle', 'busy line',
                    'joint at rest', 'refused value'})       # a value may be of another question
def unread_answers(case: Case) -> Claims:
    """
    It asks in the middle of an answer, or reads old ones.

    Do: read whole answers, and clear the input before each question.
    """
    if not _READ_WRONGLY & case.incidents_by_kind.keys():
        return
    if case.count(ev.STUFFED) >= INCIDENTS_MIN:
        yield Claim('the program leaves the last byte unread of answers that byte stuffing makes '
                    'longer (FF FF FD in their data comes as FF FF FD FD): let it read as many '
                    'bytes as their Length says, and remove that FD',
                    {'read in part': case.count(ev.STUFFED)}, covers=tuple(case.by_id))
        return
    split = case.count(ev.SPLIT)
    if split >= INCIDENTS_MIN and split >= SPLIT_MIN_SHARE * case.increase_of('instructions'):
        yield Claim(f'the program reads a part of an answer and asks on, {split} times in 10 s: '
                    'let it read until the answer is whole, or its time-out is over',
                    {'read in part': split}, covers=tuple(case.by_id))
        return
    if taken := _taken_for_another(case):
        [((asked, number), _)] = taken.most_common(1)
        yield Claim(f'the program asks {asked:03}, reads the late answer of {number:03}, and '
                    'goes on: it takes answers for those of another device; let it wait '
                    f'{LONG_WAIT_MS} ms for each, check its ID, and clear its input before it '
                    'asks', {'taken for another': taken.total()}, covers=tuple(case.by_id))
        return
    if not case.count(ev.STALE):
        return
    seen = 'each time the program asks, bytes of earlier answers still wait to be read'
    harm = case.damage + sum(device.window.missed for device in case.devices)
    if harm < INCIDENTS_MIN:
        yield Doubt(f'{seen}: if it takes those for the new ones, let it clear its input before '
                    'it asks')
        return
    yield Claim(f'{seen}: it reads too few, or takes old answers for new ones; let it read whole '
                'answers, and clear its input before it asks',
                {'missed or damaged': harm}, covers=tuple(case.by_id))


def _taken_for_another(case: Case) -> Counter[tuple[int, int]]:
    """Return who was asked and who answered, where most such answers are taken; else nothing."""
    kinds = case.report.kinds
    taken = Counter((one.device, one.detail.number) for one in case.incidents(ev.TAKEN_FOR))
    are_most = kinds.get(ev.NOT_TAKEN, 0) <= TAKEN_MAX_LATER * kinds.get(ev.TAKEN_FOR, 0)
    return taken if taken.total() >= TAKEN_MIN and are_most else Counter()


@Rule(subject='bus', level=Level.ERROR,
      accounts_for={*SILENCE, 'silent bus', 'slow cycle'})
def rate_refused(case: Case) -> Claims:
    """
    The program ended as the driver of its adapter refused a baud rate.

    Do: leave that rate out, or use an adapter that has it.
    """
    if case.failed == RATE_REFUSED:
        yield Claim('the driver of the adapter refuses the rate that the program sets after '
                    f'{case.report.baud} Bd; nothing was asked at it: leave it out, or use '
                    'another adapter', is_certain=True)


@Rule(subject='bus',
      accounts_for={*SILENCE, 'silent bus', 'absence'})
def port_reopened(case: Case) -> Claims:
    """
    Opened for each question; none asked soon after is answered.

    Do: open it once, wait 2 s.
    """
    kinds = case.report.kinds
    if ev.SESSION_UNANSWERED not in kinds or ev.SESSION_ANSWERED in kinds \
            or kinds[ev.SESSION_UNANSWERED] < UNANSWERED_SESSIONS_MIN:
        return
    seen = 'the program opens the port for each question, and none asked at once is ' \
        'answered'
    if ev.SESSION_ANSWERED_LATE in kinds:
        yield Claim(f'{seen}, but one asked a second later: a board (Arduino, OpenRB) restarts as '
                    'its port is opened; let the program open it once, wait 2 s, and keep it open',
                    {'opened in vain': kinds[ev.SESSION_UNANSWERED]}, is_certain=True)
    elif not case.report.is_answered:
        yield Doubt(f'{seen}: a board (Arduino, OpenRB) that restarts as its port is opened, or '
                    'silent servos', step='let the program open it once, wait 2 s and ask: if '
                    'that is answered, keep it open')


@Rule(subject='bus', level=Level.ERROR,
      accounts_for={'unsent instructions'})
def port_lost(case: Case) -> Claims:
    """
    The driver hung up the program's port.

    Do: check USB plug, cable, hub.
    """
    if ev.PORT_LOST not in case.incidents_by_kind:
        return
    for lost in case.incidents(ev.PORT_LOST)[-1:]:
        error = _HUNG_UP.get(lost.detail.number, f'error {lost.detail.number}')
        yield Claim(f'the port was lost while the program used it ({error}): check USB plug, '
                    'cable, hub and its supply; let the program close the port and open it again',
                    is_certain=True)


@Rule(subject='bus', level=Level.ERROR,
      accounts_for={*SILENCE, *DAMAGE, 'silent bus', 'late answers', 'no acknowledgements',
                    'echo', 'unread bytes', 'wrong length', 'slow cycle'})
def line_mode(case: Case) -> Claims:
    """
    Answers are missed or damaged; its port is in line mode (ICANON) or changes bytes (ONLCR).

    Do: set the port to raw before the first question.
    """
    mode = case.report.line_mode
    if not mode:
        return
    # What is changed is damaged; a device of which nothing comes is silent for another reason.
    asked = {one.device for one in case.incidents(ev.RETURN_ADDED)}
    lost = sum(device.totals.missed for device in case.devices
               if mode & HOLDS_LINES or device.id in asked)
    if lost + case.damage >= (1 if case.failed else INCIDENTS_MIN):
        ways = []
        if case.damage or not asked:
            ways.append('changes or takes bytes, as 0D to 0A (ICRNL), or 11 and 13 (IXON)')
        if asked:
            ways.append('sends 0D 0A for each 0A (ONLCR), as in packets to '
                        f'{first_ids(sorted(asked), 3)}')
        what = 'is in line mode (ICANON): its driver holds the answers until a byte is an end ' \
            'of line' if mode & HOLDS_LINES else f'is not raw: its driver {", and ".join(ways)}'
        yield Claim(f'the port {what}; let the program set it to raw (cfmakeraw, tty.setraw), or '
                    'call `stty raw -echo` before',
                    {'missed or damaged': lost + case.damage})


@Rule(subject='bus', level=Level.ERROR,
      accounts_for={*SILENCE, *DAMAGE, 'damaged first bytes', 'no packets', 'silent bus',
                    'slow cycle'})
def wrong_packets(case: Case) -> Claims:
    """
    Packets of the program with a wrong checksum, CRC or Length, or nothing that is a packet.

    Needs a source that knows who sent what, unless each packet is wrong in the same way.

    Do: correct the program.
    """
    report = case.report
    wrong = case.incidents(ev.WRONG_PACKET) if ev.WRONG_PACKET in case.incidents_by_kind else []
    sent = report.counters['Bytes']
    if (bad := repeated_bad_packet(case)) is not None:
        whom = '' if bad.id == BROADCAST else f' to {bad.id:03}'
        yield Claim(f'each {name_of(bad.instruction)}{whom} has the wrong {bad.field}, {bad.got}, '
                    f'right is {bad.right}: no servo takes it; correct the program',
                    {'noise (bytes)': report.counters['Noise Bytes']})
    elif found := [one for one in case.cycles if one.instruction == Instruction.SYNC_WRITE
                   and _counts_the_id(case, one)]:
        size = found[0].length
        yield Claim(f'Sync Write of {size} bytes a device names IDs that never answer, and of '
                    f'{size - 1} bytes it has the same size: its length counts the ID too, so '
                    'the values go to wrong devices; correct the program',
                    {'IDs': all_ids(found[0].ids)}, level=Level.WARN)
    elif len(wrong) >= INCIDENTS_MIN:
        most = Counter((one.detail.instruction, one.device) for one in wrong)
        [((code, number), _)] = most.most_common(1)
        yield Claim(f'the master asks ID {number}{_NO_ID}' if number == NO_IDS[1] else
                    f'{len(wrong)} packets of the program have a wrong checksum, CRC or Length, '
                    f'as {name_of(code)} to {number:03}: no servo takes them; correct the program',
                    {'packets': len(wrong)})
    elif report.has_sides and ev.MALFORMED in case.incidents_by_kind \
            and case.count(ev.MALFORMED) >= INCIDENTS_MIN:
        code, size = case.incidents(ev.MALFORMED)[-1].detail
        yield Claim(f'{name_of(code)} with {size} parameter bytes makes no sense: its Length, or '
                    'the size that it gives for each device, is wrong; correct the program',
                    level=Level.WARN)
    elif report.has_sides and not report.is_answered and report.counters['Packet Bytes'] == 0 \
            and report.counters['Noise Bytes'] >= SENT_MIN_BYTES:      # not one that may be whole
        what = 'correct their checksum, CRC or Length' if HEADER in report.noise else \
            'packets begin with FF FF; send them as bytes, not as text'
        yield Claim(f'none of the {sent} bytes that the program sent is part of a packet that a '
                    f'servo takes: {what}', {'bytes': sent})


def _counts_the_id(case: Case, cycle: Cycle) -> bool:
    """Tell whether a Sync Write has IDs out of order, as values of the right length are there."""
    ids, size = cycle.ids, cycle.length
    if cycle.asked < INCIDENTS_MIN or size < 2 or len(ids) % size or [*ids] == sorted(ids):
        return False
    heard = [number in case.by_id and case.by_id[number].last_heard_s is not None
             for number in ids]
    return heard[0] and 2 * sum(heard) < len(ids)


@Rule(subject='bus')
def impossible_id(case: Case) -> Claims:
    """
    Asks ID 255, or 253 in Protocol 2.0; reads from 254.

    Do: correct the ID; use Sync Read.
    """
    for cycle in case.cycles:
        number = next(iter(cycle.ids), None)
        reads_all = number == BROADCAST and cycle.instruction == Instruction.READ
        if not reads_all and (number not in NO_IDS or number in case.by_id):
            continue
        asked = case.times_asked(cycle)
        if asked >= INCIDENTS_MIN:
            yield Claim(f'the master reads from ID {number}, all devices at once, which '
                        'none answers: use Sync Read' if reads_all else
                        f'the master asks ID {number}{_NO_ID}', {'asked in 10 s': asked})
            return


@Rule(subject='bus',
      accounts_for={'refused value', 'joint at rest'})       # its goals do not arrive
def unstuffed(case: Case) -> Claims:
    """
    `FF FF FD` in the data without the extra `FD`.

    Do: use another library.
    """
    notes = case.incidents(ev.UNSTUFFED)
    if notes:
        last = notes[-1]
        yield Claim('the master sends FF FF FD without byte stuffing '
                    f'({name_of(last.detail.instruction)} to {last.device:03}), like the '
                    'Python SDK: a device may miss the packet; correct its '
                    'library', {'packets': len(notes)})


# --- what devices refuse -------------------------------------------------------------------------

@Rule(needs_incident=(ev.REFUSED,),
      accounts_for={'refused access'})
def eeprom_locked(case: Case, device: DeviceReport) -> Found | None:
    """
    A write to EEPROM refused.

    Do: write Torque Enable 0 first.
    """
    torque = raw_value(case, device, 'Torque Enable')
    # Where it is on, that explains one.
    least = least_refusals(case, device, INCIDENTS_MIN) if torque is None else 1
    address, _, count = most_refused(case, device, lambda one: (
        one.instruction in SINGLE_WRITES and _is_locked(device, one)))
    if count < least or torque == 0:
        return None
    times = f'{count} times' if count > 1 else 'once'
    return Claim(f'write to {device.model.by_address[address].name} ({address}) refused {times}: '
                 'EEPROM cannot be written while the torque is on; switch it off first',
                 {'refused': count})


def _is_locked(device: DeviceReport, one: ev.Refusal) -> bool:
    field = device.model.by_address.get(one.address)
    return one.error == ACCESS_ERROR and field is not None and field.memory == 'eeprom' \
        and 'w' in field.access


@Rule(needs_incident=(ev.REFUSED,), needs_model=True,
      symptoms={'refused address'})
def wrong_address(case: Case, device: DeviceReport) -> Found | None:
    """
    One address refused three times.

    Do: use the control table of this model.
    """
    address, error, count = most_refused(case, device, lambda one: (
        one.error in (ACCESS_ERROR, LENGTH_ERROR, RANGE_ERROR) and not _is_locked(device, one)))
    if count < least_refusals(case, device, INCIDENTS_MIN):
        return None
    return Claim(f'address {address} refused {count} times '
                 f'({error_text(error)}): {_what_is_there(device, address, error)}',
                 {'refused': count})


def _what_is_there(device: DeviceReport, address: int, error: int) -> str:
    field = device.model.by_address.get(address)
    name, series = _OTHER_SERIES.get(address, ('', ''))
    if name and (field is None or field.name != name):
        return f'{name} of the {series} series; use the control table of {device.model_name}'
    if field is None:
        return f'{device.model_name} has no register there; check the control table in use'
    if error == RANGE_ERROR:
        return f'the value is out of the range of {field.name}; limit it'
    return f'{field.name} ({field.access}, {field.size} bytes) does not allow this access'


@Rule(needs_incident=(ev.REFUSED,),
      symptoms={'refused access'})
def refused(case: Case, device: DeviceReport) -> Found | None:
    """
    One address refused three times, and its model is not known.

    Do: set its model in `devices`.
    """
    address, error, count = most_refused(        # a wrong CRC is damage on the way
        case, device, lambda one: one.address >= 0 and one.error != CRC_ERROR)
    if count < INCIDENTS_MIN or device.model.number is not None:
        return None
    last = case.incidents(ev.REFUSED, device)[-1].detail
    return Claim(f'refuses {name_of(last.instruction)} at {address} '
                 f'({error_text(error)}): set its model in {case.names.devices} to learn '
                 'which register that is', {'refused': count})


# --- how it goes on ------------------------------------------------------------------------------

@Rule(subject='bus', holds=False)
def master_stopped(case: Case) -> Claims:
    """
    No more instructions after 2.5 s of them or more.

    An advice below 10 s, unless its last question got no answer.

    Do: check the program and its cable.
    """
    report = case.report
    if case.quiet_s < STOPPED_MIN_S or (report.last_byte_s or 0.0) < STOPPED_MIN_S \
            or report.stamp - report.deaf < STOPPED_MIN_S * NS_PER_S \
            or ev.PORT_LOST in report.kinds or report.is_closed:
        return                                 # a closed port hears no master
    since = (report.asked - case.run_from) / NS_PER_S
    if since < WORKED_MIN_S:
        return                                 # a command, and it is done
    last = case.last_wait
    if last is not None and (last.is_spoilt or last.instruction == Instruction.PING):
        last = None
    what = 'check its program' if last is None else f'{last.device:03} did not answer its last ' \
        f'{name_of(last.instruction)}: let it read with a time-out'
    yield Claim(f'the master stopped after it had asked for {since:.1f} s: {what}; device states '
                'date from then', {'stopped after (s)': f'{since:.1f}'},
                Level.OK if case.quiet_s < STOPPED_WARN_S and last is None else None)


@Rule(subject='bus', level=Level.OK, holds=False,
      accounts_for={'damaged packets', 'damaged answers', 'stray bytes', 'damaged first bytes',
                    'uneven rhythm'})
def scan(case: Case) -> Claims:
    """
    Many IDs pinged; WARN if broadcast Pings collide.

    Do: wait 0.8 s after a broadcast Ping.
    """
    pings = sum(map(case.times_asked, [
        cycle for cycle in case.cycles
        if cycle.instruction == Instruction.PING and cycle.ids == (BROADCAST,)]))
    collide = case.damage >= INCIDENTS_MIN
    if pings >= SCAN_MIN_PINGS or (collide and pings >= INCIDENTS_MIN
                                   and pings > SCAN_MIN_SHARE * case.increase_of('instructions')):
        yield Claim('the master sends broadcast Pings without a '
                    f"pause{', and the answers collide' if collide else ''}: let it wait "
                    '0.8 s after each, the time that all IDs need',
                    {'broadcast Pings in 10 s': pings},
                    Level.WARN if collide else Level.OK)
    elif case.report.scanned:
        yield Claim(f'a scan: {len(case.report.scanned)} IDs were pinged and do not answer, '
                    f'{len(case.devices)} devices are known',
                    {'without an answer': first_ids(case.report.scanned)}, stands_alone=True)


@Rule(subject='bus', level=Level.OK)
def models(case: Case) -> Claims:
    """
    Devices of unknown models, as `cannot tell.models`.

    Do: set `devices`, or send Ping.
    """
    found: dict[str, list[int]] = {}
    for device in case.devices:
        if device.model.number is None and device.last_heard_s is not None:
            found.setdefault(_what_is_unknown(device, case.names), []).append(device.id)
    if found and case.heard_s >= POLLED_MIN_S:
        yield Doubt('; '.join(f'{first_ids(ids, 3)}: {words}' for words, ids in found.items()))


def _what_is_unknown(device: DeviceReport, names: Names) -> str:
    if device.model_number is not None:
        return f'model {device.model_number} has no model file: add one to {names.folders}'
    model = device.model
    registers = 'so registers have no names and some causes cannot be found' \
        if model is UNKNOWN else f'registers that {model.name} share, by what the program uses' \
        if ' and ' in model.name else f'registers as in {model.name}, by what the program uses'
    how = 'ping the servos' if device.protocol == PROTOCOL_2 else \
        f'read the model of the servos (2 bytes at {_MODEL_AT.get(device.protocol, "0 or 3")})'
    return f'model not known, {registers}; add ID:MODEL to {names.devices}, or let your ' \
        f'program {how}'


def with_models_named(report: BusReport, names: Names) -> BusReport:
    """Return a report whose messages say which models are not known, where all else is well."""
    return report._replace(
        message=f'{report.message}; not all models known: set {names.devices}',
        devices=tuple(one._replace(message=f'{one.message}; {_what_is_unknown(one, names)}')
                      if one.model.number is None and one.state == CONNECTED
                      and one.level is Level.OK else one for one in report.devices))


@Rule(accounts_for={'joint at rest'})
def eeprom_wear(case: Case, device: DeviceReport) -> Found | None:
    """
    Thirty EEPROM writes in ten seconds.

    Do: write only what changes.
    """
    count = device.window.eeprom_writes
    if count < EEPROM_WRITES_MIN or device.id in case.gone:
        return None                            # what is silent takes no writes
    rate = count / min(max(case.heard_s, 1.0), WINDOW_S)
    names = [one.field.name for one in device.observed if one.source == 'w'
             and one.field.memory == 'eeprom' and one.age_s < EEPROM_AGE_MAX_S]
    what = f" ({', '.join(names[:3])})" if names else ''
    hours = f'{100_000 / rate / 3600:.1g}'
    return Claim(f'EEPROM written about {float(f"{rate:.1g}"):g} times a second{what}: it lasts '
                 f'about 100 000 writes, {hours} hours at this rate; write only what changes',
                 {'writes': count})


@Rule(level=Level.OK, onset_s=ACKS_ONSET_S, holds=False,
      symptoms={'no acknowledgements'},
      accounts_for={'missed answers', 'silent device'})
def no_acks(case: Case, device: DeviceReport) -> Found | None:
    """
    No answers to writes: Status Return Level 1; WARN where the program waits, or ended on that.

    Do: nothing, if the master knows; else level 2.
    """
    last = fatal_wait(case)
    has_ended = last is not None and last.device == device.id and device.acks is None \
        and last.instruction in SINGLE_WRITES and device.totals.answers > device.totals.pongs
    if not has_ended and (not case.recent_counts(device, ANSWERS_OTHERWISE_S).answers
                          or device.missed_in_a_row > ACKS_MISSING_MIN):
        return None                            # it answers nothing at present
    are_missing = device.acks_missing >= ACKS_MISSING_MIN
    unanswered = case.count(ev.ACKS_STOPPED, device) or are_missing
    if (device.acks and not are_missing) or device.window.spoilt >= INCIDENTS_MIN:
        return None                            # it does again, or they came damaged
    if not (has_ended or unanswered or device.status_return_level in (0, 1)):
        return None
    shift = -1 if case.report.protocol == FEETECH.name else 0     # its 0 and 1 are 1 and 2 here
    if has_ended and any(one.acks for one in case.devices):
        return Doubt('did not acknowledge its first write, as others do, and the program ended '
                     f'there: it is silent since then, or has Status Return Level {1 + shift}',
                     device.id, f'ping {device.id:03} alone: if it answers, set its Status Return '
                     f'Level to {2 + shift}; if not, check its power and plug')
    level = device.status_return_level
    says = f'below {2 + shift}' if level is None else f'{level + shift}'
    waits_ms = _vain_wait_ms(case, device) if unanswered else 0.0
    harm = f'the program waits for that in vain, {waits_ms:.0f} ms of each cycle' if waits_ms \
        else 'a master that waits for it loses a time-out each time'
    return Claim(f'does not acknowledge writes (Status Return Level {says}): {harm}; use Sync '
                 f'Write or level {2 + shift}'
                 f"{'; if it has that, check its plugs' * has_ended}",
                 level=Level.WARN if has_ended or waits_ms else None, is_certain=has_ended,
                 rests_on=() if has_ended or unanswered else (ANSWER,))


def _vain_wait_ms(case: Case, device: DeviceReport) -> float:
    """Return how much of each cycle is waiting for a device, 0 if that is no harm or unknown."""
    times = case.report.cycle
    if times is None or times.is_blurred:
        return 0.0
    waited = dict(times.waiting).get(device.id, 0.0)
    return waited if waited >= ACKS_WAIT_MIN_SHARE * times.cycle else 0.0


@Rule(level=Level.OK,
      symptoms={'no writes'})
def never_written(case: Case, device: DeviceReport) -> Found | None:
    """
    Only read, while others are written.

    Do: check whether the program forgot it.
    """
    if device.totals.writes or device.totals.reads < POLLED_MIN_READS \
            or 'Goal Position' not in device.model.by_name \
            or case.heard_s < POLLED_MIN_S or not device.window.answers:
        return None
    written = [one.id for one in case.devices if one.window.writes]
    if not written:
        return Doubt('read but never written, like all others: this master may only '
                     'monitor')
    return Claim(f'read {device.totals.reads} times but never written, others are '
                 f'({first_ids(written, 2)}): check whether the program forgot it',
                 {'reads': device.totals.reads})


@Rule(accounts_for={'joint at rest'})
def no_action(case: Case) -> Claims:
    """
    Reg Writes, one after the other, and no Action after them.

    Do: send Action to it, or to all (ID 254).
    """
    if ev.REPLACED not in case.incidents_by_kind:
        return
    replaced = {one.device: one.detail.number for one in case.incidents(ev.REPLACED)}
    for number, times in replaced.items():
        if times >= INCIDENTS_MIN:
            yield Claim('Reg Writes wait for an Action that does not come: send Action to it, or '
                        f'to all (ID {BROADCAST})', {'Reg Writes without one': times + 1},
                        device=number)


# --- reads of several devices at once ------------------------------------------------------------

@Rule(symptoms={'unanswered group reads'},
      accounts_for={*SILENCE, 'silent bus', 'damaged packets', 'damaged answers',
                    'refused address', 'absence'})
def fast_read_unsupported(case: Case) -> Claims:
    """
    No part in fast reads.

    Do: update its firmware, or use Sync Read.
    """
    found: dict[int, Claim] = {}
    for cycle in case.cycles:
        if cycle.instruction in FAST_READS and cycle.stamps and cycle.asked >= INCIDENTS_MIN \
                and case.now - cycle.stamps[-1] <= 2 * NS_PER_S:
            first = next((case.by_id[number] for number in cycle.ids if number in case.by_id
                          and not case.by_id[number].totals.fast_answers), None)
            if first is not None and not _may_be_absent(case, first):
                found.setdefault(first.id, _claim_fast_read(cycle, first))
    yield from found.values()


def _may_be_absent(case: Case, device: DeviceReport) -> bool:
    """Tell whether a device that could take part gives no answer to anything else either."""
    refused = sum(one.detail.instruction in FAST_READS and one.detail.error == INSTRUCTION_ERROR
                  for one in case.incidents(ev.REFUSED, device))
    is_able = device.firmware is not None \
        and device.firmware >= _fast_reads_since(device.model_number) \
        and case.recent_counts(device, ANSWERS_OTHERWISE_S).answers < INCIDENTS_MIN
    return refused < INCIDENTS_MIN and (is_able or not device.totals.answers)


def _claim_fast_read(cycle: Cycle, device: DeviceReport) -> Claim:
    firmware = '' if device.firmware is None else f', firmware {device.firmware}'
    after = cycle.ids[cycle.ids.index(device.id):]
    return Claim('answers, but never a fast read '
                 f'({device.model_name}{firmware}), so devices after it are never read: update it '
                 'or use plain Sync Read',
                 {'fast reads': cycle.asked}, covers=tuple(after), device=device.id)


def _fast_reads_since(model_number: int | None) -> int:
    """Return the firmware from which on a model has fast reads (e-Manual, Fast Sync Read)."""
    return next((firmware for numbers, firmware in _FAST_SINCE if model_number in numbers), 0)


@Rule(subject='bus',
      symptoms={'unanswered group reads'},
      accounts_for={*SILENCE, 'silent bus', 'absence', 'unanswered group reads'})
def sync_read_unsupported(case: Case) -> Claims:
    """
    Nothing answers Sync Reads (1.0, SCS) or Bulk Reads (AX), but other instructions.

    Do: read one after the other.
    """
    is_feetech = case.report.protocol == FEETECH.name
    if case.count(ev.UNASKED) or case.count(ev.LATE) \
            or case.report.protocol not in (DYNAMIXEL_1.name, UNDECIDED.name, FEETECH.name) \
            or sum(device.totals.answers for device in case.devices) < INCIDENTS_MIN:
        return
    for cycle in case.cycles:
        if cycle.instruction == Instruction.SYNC_READ \
                and case.times_asked(cycle, ANSWERS_OTHERWISE_S) >= INCIDENTS_MIN and (
                    not is_feetech or _answer_single_reads(case, cycle)):
            yield Claim('the master sends Sync Reads, which Dynamixel has in Protocol 2.0 '
                        'only, and Feetech SCS not at all: none is answered, other instructions '
                        'are; read one after the other',
                        {'Sync Reads': cycle.asked})
        elif cycle.instruction == Instruction.BULK_READ \
                and case.times_asked(cycle, ANSWERS_OTHERWISE_S) >= INCIDENTS_MIN \
                and (without := _without_bulk_read(case, cycle)):
            yield Claim(f'the master sends Bulk Reads, which {without} does not have: none is '
                        'answered, other instructions are; read one after the other',
                        {'Bulk Reads': cycle.asked})


def _without_bulk_read(case: Case, cycle: Cycle) -> str:
    """Return a model that is asked, never answers, and has no Bulk Read (e-Manual: MX alone)."""
    if cycle.missed < cycle.asked - 1:
        return ''
    names = (case.by_id[number].model_name for number in cycle.ids if number in case.by_id)
    return next((name for name in names if name.startswith(NO_BULK_READ)), '')


def _answer_single_reads(case: Case, cycle: Cycle) -> bool:
    """Tell whether Feetech servos may lack Sync Read: each answers, and never this one."""
    members = [case.by_id[number] for number in cycle.ids if number in case.by_id]
    return cycle.missed >= cycle.asked - 1 and bool(members) and all(
        case.recent_counts(one, ANSWERS_OTHERWISE_S).answers >= INCIDENTS_MIN
        and not one.model_name.startswith(HAVE_SYNC_READ) for one in members)


@Rule(symptoms={'unanswered group reads'},
      accounts_for={*SILENCE, 'silent bus', 'absence', 'absence of several', 'slow cycle'})
def group_read_unanswered(case: Case) -> Claims:
    """
    Answers single instructions all the time, and never one Sync Read or Bulk Read.

    A device waits there for the status of the one before it in the list.

    Do: read it by single Reads; update its firmware, or let it hear the one before it.
    """
    for cycle in case.cycles:
        if cycle.instruction in GROUP_READS \
                and cycle.missed >= max(GROUP_READS_MIN, cycle.asked - 1):
            yield from (_claim_unanswered(cycle, device) for device in case.devices
                        if device.id in cycle.ids and _is_lost_there_only(case, cycle, device))


def _is_lost_there_only(case: Case, cycle: Cycle, device: DeviceReport) -> bool:
    """Tell whether a device is lost in this instruction, and in no other one."""
    lately = case.recent_counts(device, ANSWERS_OTHERWISE_S)
    if 0 < lately.answers == lately.pongs \
            or device.totals.missed < MISSED_ALIKE_MIN_SHARE * cycle.missed \
            or device.window.answers - device.window.pongs < GROUP_READS_MIN \
            or _may_come_late(case, device):
        return False
    missed = case.incidents(ev.MISSED, device)
    alike = sum((one.detail.instruction, one.detail.address) == (cycle.instruction, cycle.address)
                for one in missed)
    return alike >= max(GROUP_READS_MIN, MISSED_ALIKE_MIN_SHARE * len(missed))


def _claim_unanswered(cycle: Cycle, device: DeviceReport) -> Claim:
    name, at = name_of(cycle.instruction), cycle.ids.index(device.id)
    before = f'{cycle.ids[at - 1]:03}' if at else ''
    place = f' (it is after {before})' if at else ''
    remedy = f'let it hear the status of {before}' if at else 'update its firmware'
    return Claim(f'answers single instructions and never the {name} of {first_ids(cycle.ids, 3)}'
                 f'{place}: no plug does that; read it by single Reads, or {remedy}',
                 {name: cycle.asked,
                  'other answers in 10 s': device.window.answers - device.window.pongs},
                 covers=cycle.ids[at + 1:], device=device.id)


@Rule(needs_incident=(ev.MISSED,),
      symptoms={'unanswered group reads'},
      accounts_for={*SILENCE, *DAMAGE, 'late answers', 'slow cycle', 'absence of several'})
def group_read_collides(case: Case) -> Claims:
    """
    Two answer single instructions, and collide in each Sync Read or Bulk Read: one is out of turn.

    Do: read it by single Reads; let it answer after the status of the one before it.
    """
    for cycle in case.cycles:
        if cycle.instruction in GROUP_READS and cycle.asked >= GROUP_READS_MIN:
            members = [case.by_id[number] for number in cycle.ids if number in case.by_id]
            hit = [one for one in members
                   if one.totals.spoilt >= COLLIDE_MIN_SHARE * cycle.asked
                   and one.window.answers - one.window.pongs >= GROUP_READS_MIN]
            missed = [one.totals.missed for one in members if one not in hit]
            if len(hit) == 2 and max(missed, default=cycle.asked) < LOST_MAX_SHARE * cycle.asked:
                first, last = (one.id for one in hit)
                yield Claim(f'{first:03} and {last:03} answer single instructions, and collide in '
                            f'each {name_of(cycle.instruction)}: one does not wait for its turn; '
                            f'read {last:03} by single Reads, or let its firmware answer after '
                            'the status of the one before it',
                            {name_of(cycle.instruction): cycle.asked}, covers=(first, last),
                            device=last)


def _may_come_late(case: Case, device: DeviceReport) -> bool:
    """Tell whether the program may give up, or throw away, answers that do come."""
    return device.window.spoilt > 0 \
        or any(case.count(kind) for kind in (ev.STALE, ev.UNASKED, ev.THROWN_AWAY, ev.LATE))


RULES = (rate_refused, port_lost, port_reopened, line_mode, unread_answers, wrong_packets,
    eeprom_locked, wrong_address, refused, impossible_id, master_stopped, scan,
    models, eeprom_wear, fast_read_unsupported, sync_read_unsupported, group_read_unanswered,
    group_read_collides,
    unstuffed, no_acks, never_written, no_action)
