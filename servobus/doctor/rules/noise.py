# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Noise and unknown bytes: damaged on the way, or not meant for this bus."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from functools import lru_cache
from itertools import takewhile
from math import sqrt
import re

from msg_defs.diagnostics import Level
from msg_defs.dxl1_instruction import DIALECTS
from msg_defs.dxl1_instruction import FEETECH
from msg_defs.dxl1_instruction import UNDECIDED
from msg_defs.dxl1_packet import HEADER as FAMILY_HEADER
from msg_defs.dxl_instruction import ADAPTER_READ
from msg_defs.dxl_instruction import Instruction
from msg_defs.dxl_instruction import name_of
from msg_defs.dxl_instruction import NAMES
from msg_defs.dxl_packet import BROADCAST
from msg_defs.dxl_packet import HEADER
from msg_defs.nanoseconds import NS_PER_S
from msg_defs.uart import byte_ns
from msg_defs.uart import heard_at
from servobus.bus import evidence as ev
from servobus.bus import report as words
from servobus.bus.report import DeviceReport
from servobus.bus.report import IdWrite
from servobus.doctor.bit_errors import cut_packets
from servobus.doctor.bit_errors import expected_packets
from servobus.doctor.bit_errors import TWO_SENDERS
from servobus.doctor.case import Case
from servobus.doctor.facts import count_early_ends
from servobus.doctor.facts import count_early_reads
from servobus.doctor.facts import CRC_ERROR
from servobus.doctor.facts import is_collision
from servobus.doctor.facts import is_overlaid
from servobus.doctor.facts import may_overlap
from servobus.doctor.facts import ran_into_answers
from servobus.doctor.rule import about
from servobus.doctor.rule import all_ids
from servobus.doctor.rule import Claim
from servobus.doctor.rule import Claims
from servobus.doctor.rule import Doubt
from servobus.doctor.rule import first_ids
from servobus.doctor.rule import Found
from servobus.doctor.rule import Rule
from servobus.doctor.rule import share
from servobus.doctor.rule import STOP_OTHERS
from servobus.doctor.symptom import DAMAGE
from servobus.doctor.symptom import SILENCE
from servobus.doctor.symptom import TRAFFIC
from servobus.doctor.thresholds import INCIDENTS_MIN
from servobus.doctor.thresholds import WINDOW_S
from servobus.printable_text import printable

NOISE_MIN_PACKETS = 5              # damaged ones: fewer have no common cause
NOISE_MIN_SHARE = 0.001            # share of all packets
# Below this share damage of no clear kind may be a second program as well, which asks now and then
# and runs into one packet in a thousand; one that shares the bus all the time hits more. Where the
# sides are known its instructions would have been seen.
NOISE_SURE_MIN_SHARE = 0.002
STRAY_PACKETS_MIN = 5              # after a stray byte
STRAY_PACKETS_MIN_SHARE = 0.001    # share of all packets
ONE_DEVICE_MIN_SHARE = 0.7         # share of the damage: it is that of one device
BOTH_WAYS_MIN_SHARE = 0.2          # share of the damage, in instructions: both directions suffer
DAMAGE_ONSET_S = 1.0               # by then it has shown whether something else does it
TURNAROUND_MIN_SHARE = 0.01        # share of the answers, with a damaged first byte
FIRST_BYTE_BY_CHANCE = 1 / 8       # share of damage that hits a first byte by chance
CUT_MIN_SHARE = 0.9                # share of the noise: nothing else is wrong
DUPLICATE_MIN_ANSWERS = 5          # with bytes after them
DUPLICATE_MIN_SHARE = 0.2          # share of the questions: a second device answers each time
TWIN_MIN_ANSWERS = 15              # the shares of fewer differ by chance
TWIN_MIN_FACTOR = 1.5              # two answer twice as often as one
AGAIN_MIN_SHARE = 0.7              # share of the damage, where its answer comes once more
SECOND_ANSWERS_FACTOR = 1.5        # times those that come at any other time
ECHO_MIN_INSTRUCTIONS = 5
ECHO_SKIPPED_MAX_LOST = 0.1        # share of the echoes: on a busy computer some answers are
ECHO_MIN_SHARE = 0.1               # share of the instructions: some run into answers
ECHO_MAX_US = 100                  # from an instruction to its echo
PACKETS_BY_CHANCE = 0.005          # at most this share of bytes is packets at a wrong rate
WRONG_BAUD_MIN_BYTES = 300         # as many are no noise
WRONG_BAUD_WINDOW_S = 2.0
LOAD_IMPOSSIBLE_PERCENT = 120.0    # wire time that no bus of this rate has
BURST_NS = NS_PER_S                # a source may hand over so much wire time late
AFTER_WRITE_S = 0.5                # an acknowledgement and a write to Lock may follow
TEXT_MIN_BYTES = 16                # in a row: fewer are printable by chance
ALL_TEXT_MIN_BYTES = 10            # where all that came is text
TEXT_MIN_SHARE = 0.7               # share of the noise; bytes at a wrong rate have less
WORDS_MIN_SHARE = 0.3              # share of a text that is letters and digits; JSON has few
TEXT_SHOWN = 24                    # characters
FOLLOW_S = 1.0                     # a program sets its own rate after that of a servo
TEXT_ONLY_MIN_WAITS = 10           # for answers that do not come after it
BOOT_S = 2.0                       # a board starts when its port is opened, and prints so long
COMMON_RATES = (9600, 57_600, 115_200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000)
RATE_MIN_HEADERS = 3
RATE_MIN_BYTES = 2                 # from a header as it looks: fewer say nothing
_CHARACTERS = rb'\t\n\r\x20-\x7e'
# Lines or the beginning of one: words, numbers; bytes by chance are not so long or have no words.
_TEXT = re.compile(rb'[%b]{%d,}' % (_CHARACTERS, TEXT_MIN_BYTES))
_OF_WORDS = re.compile(rb'[A-Za-z0-9]')
_MODEM = re.compile(rb'(?:AT[A-Z0-9+&=?]*[\r\n]+){2}')
_NMEA = re.compile(rb'\$[A-Z]{5},')        # the begin of a sentence of a GPS receiver
_LOGIN = re.compile(rb'login:|[Pp]assword:|[#$] $')
# An answer to one of these shows that power and rate are right.
_ASKING = {Instruction.PING, Instruction.READ, Instruction.WRITE}
# What is said of a bus without a packet where the bytes are too few for the rule.
NO_PACKETS = ('bytes, but no packet: set {bauds} to the rate of the bus, and check that it is a '
              'servo bus and that D+ and D- are not swapped')


# --- the wrong rate, ID or protocol --------------------------------------------------------------

@Rule(subject='bus', level=Level.ERROR,
      symptoms={'no packets'},
      accounts_for=TRAFFIC)
def wrong_baud(case: Case) -> Claims:
    """
    Hardly a packet among the bytes, or more bytes than the rate allows.

    Or no packet comes back to a program, and other bytes do.

    Do: set `bauds`, or the rate of the program.
    """
    report = case.report
    got, good, errors = (case.increase_of(name, WRONG_BAUD_WINDOW_S)
                         for name in ('bytes', 'packet_bytes', 'framing'))
    if not report.baud:                # it is still to be learned
        return
    if (load := _load_percent(case)) > LOAD_IMPOSSIBLE_PERCENT:
        yield Claim(f'more bytes than {report.baud} Bd can carry: the bus is faster; set '
                    f'{case.names.bauds} to its rate', {'load (%)': f'{load:.0f}'})
        return
    rate_of = case.names.bauds         # below: two servos that collide leave the header whole
    if report.has_sides and len(report.devices) > 1 and FAMILY_HEADER not in report.noise \
            and all(device.last_heard_s is None for device in report.devices):
        got, good, rate_of = got - good, 0, 'the rate of the program'    # what that sends is whole
    if not report.is_answered or got < max(WRONG_BAUD_MIN_BYTES, good / PACKETS_BY_CHANCE) \
            or case.count(ev.PROTOCOL_1) or count_early_ends(case) or count_early_reads(case):
        return
    rate = likely_rate(report.noise, report.baud)
    remedy = f'the bytes look like {rate} Bd: set {rate_of} to it' if rate else \
        f'the right rate is unknown: set {rate_of} to the rate of the bus'
    yield Claim(f'{got} bytes, but no packets at {report.baud} Bd: {remedy}',
                {'bytes': got, 'framing errors': errors})


def _load_percent(case: Case) -> float:
    """Return the share of wire time since the start (%), 0 where it may be a burst, or an echo."""
    report = case.report
    heard_ns = max(1, case.now - report.started)
    needed_ns = report.counters['Bytes'] * byte_ns(report.baud)
    if report.has_sides or needed_ns - heard_ns < BURST_NS:
        return 0.0
    return 100 * needed_ns / heard_ns


def likely_rate(noise: bytes, baud: int) -> int | None:
    """Return the Dynamixel rate at which headers look like these bytes; None if unsure."""
    ranks = {rate: (noise.count(look), len(look))
             for rate, look in _headers_at_rates(baud).items()}
    best = max(ranks.values())
    rates = [rate for rate, rank in ranks.items() if rank == best]
    return rates[0] if best[0] >= RATE_MIN_HEADERS and len(rates) == 1 else None


@lru_cache(maxsize=16)
def _headers_at_rates(baud: int) -> dict[int, bytes]:
    """Return what the first bytes of a packet look like, for each rate the bus may have."""
    looks = {rate: _header_at(baud / rate) for rate in COMMON_RATES if rate != baud}
    return {rate: look for rate, look in looks.items() if len(look) >= RATE_MIN_BYTES} \
        or {baud: HEADER}


def _header_at(ratio: float) -> bytes:
    """Return the bytes that are the same for every ID after the header."""
    looks = [heard_at(HEADER + bytes([number, 4, 0]), ratio) for number in (1, 0x55, 0xFE)]
    same = takewhile(lambda column: len({*column}) == 1, zip(*looks, strict=False))
    return bytes(column[0] for column in same)


@Rule(subject='bus', level=Level.ERROR,
      accounts_for={*TRAFFIC, 'no packets', 'two protocols'})
def text(case: Case) -> Claims:
    """
    Text in place of packets: of a board's own firmware, a login prompt, a modem, a GPS receiver.

    WARN where the program asked, or ended, while the board started.

    Do: pass-through on the board; no login prompt; stop ModemManager; use the right port.
    """
    noise, devices = case.report.noise, case.devices
    if not noise or not case.report.is_answered:
        return
    answers = any(device.window.answers for device in devices)
    # Some answer by now: those that were asked while it started, and not again, did not.
    was_late = any(device.window.spoilt and not device.totals.answers for device in devices)
    is_between = answers and not was_late              # then it spoils some of them
    if (is_between and case.spoilt < INCIDENTS_MIN) or not (first := first_words(noise)):
        return
    since = min(WINDOW_S, case.heard_s - BOOT_S)
    goes_on = since > 0 and case.increase_of('bytes', since) \
        - case.increase_of('packet_bytes', since) >= TEXT_MIN_BYTES
    seen = f'text {"comes back" if case.has_sides else "is on the bus"} (`{first}`)'
    if is_between:
        if goes_on:
            yield Claim(f'{seen} between the answers, and spoils some: a board on the way prints '
                        'it; switch its debug output off', level=Level.WARN)
    elif _MODEM.search(noise):
        yield Claim(f'{seen}, the commands of a modem: ModemManager or another program uses the '
                    'port; stop it')
    elif len(_NMEA.findall(noise)) > 1:
        yield Claim(f'{seen}, as a GPS receiver sends: this is its port; use that of the servos, '
                    'by its name in /dev/serial/by-id')
    elif _LOGIN.search(noise):
        yield Claim(f'{seen}: a login prompt has the port; switch that off (on Linux: systemctl '
                    'disable --now serial-getty@PORT)')
    elif goes_on and not answers:
        yield Claim(f'{seen}: the board runs firmware of its own and passes nothing on to the '
                    'servos; switch it to pass-through, unless this is the wrong port')
    elif case.failed or answers:
        yield Claim(f'{seen} while the board starts: wait 2 s after opening the port; if text '
                    'still comes then, switch the board to pass-through',
                    {}, Level.WARN)
    elif len(case.report.waits) < TEXT_ONLY_MIN_WAITS or answers:
        yield Doubt(f'{seen} at first: if servos with power do not answer later, the board passes '
                    'nothing on')
    else:
        yield Claim(f'{seen} at first, and then nothing: the board passes nothing on to the '
                    'servos (switch it to pass-through), or they have no power')


@lru_cache(maxsize=1)              # it is asked at each report
def first_words(noise: bytes) -> str:
    """Return the first words of a text in the noise, '' where there is none."""
    found = max(_TEXT.findall(noise), key=len, default=b'')
    text = re.sub(rb'[^%b]' % _CHARACTERS, b'', noise)
    if not found and (_MODEM.search(noise) or ALL_TEXT_MIN_BYTES <= len(noise) == len(text)):
        found = noise
    if len(text) < TEXT_MIN_SHARE * len(noise) \
            or len(_OF_WORDS.findall(found)) < WORDS_MIN_SHARE * len(found):
        return ''
    lines = [line.strip() for line in found.decode('ascii', 'replace').splitlines()]
    return printable(next(filter(None, [*lines[1:], *lines]), ''), TEXT_SHOWN)     # a whole one


@Rule(subject='bus',
      symptoms={'lost bytes'},
      accounts_for={*DAMAGE, 'damaged first bytes', 'second answers', 'unasked answers'})
def overrun(case: Case) -> Claims:
    """
    The monitor's serial driver lost bytes.

    Do: raise the monitor's priority, use a better adapter.
    """
    lost = case.increase_of('overruns')
    if lost > 0:
        yield Claim(f'this computer lost bytes {lost} times, so packets seem missing or '
                    'damaged: give the monitor a higher priority or a better adapter',
                    {'overruns': lost})


@Rule(holds=False,
      symptoms={'changed rate'},
      accounts_for={*SILENCE, 'slow cycle', 'joint at rest'})
def baud_moved(case: Case, device: DeviceReport) -> Found | None:
    """
    Silent since the master changed its Baud Rate.

    Do: change it back, or change all the others.
    """
    code = _value_written(case, device, 'Baud Rate')
    to = device.moved_to or (f'code {code}' if code >= 0 else '')
    if not to or to.startswith(words.NEW_ID) or not (code >= 0 or device.state == words.MOVED):
        return None
    written = case.values[device.id].get('Baud Rate')
    if written is not None and written.age_s < FOLLOW_S and not (
            device.missed_in_a_row or device.acks_missing):
        return None                    # the program may go to that rate, too
    return Claim(f'its baud rate was set to {to}, but the bus is at '
                 f'{case.report.baud} Bd: undo that at the new rate, or set the '
                 'others and the master to it')


@Rule(holds=False,
      accounts_for={*SILENCE, 'silent bus', 'slow cycle'})
def id_moved(case: Case, device: DeviceReport) -> Found | None:
    """
    Asked by its old ID since the master changed it.

    Do: use the new ID in the program.
    """
    number = _value_written(case, device, 'ID')
    to = device.moved_to if device.state == words.MOVED else f'{words.NEW_ID}{number:03}'
    if not to.startswith(words.NEW_ID) or (to != device.moved_to and number in (-1, device.id)):
        return None
    return Claim(f'set to {to} by a write, and still asked as '
                 f'{device.id:03}: use the new ID in the program')


@Rule(subject='device or bus', level=Level.ERROR, holds=False,
      accounts_for={*SILENCE, *DAMAGE, 'silent bus', 'changed rate', 'second answers',
                    'damaged first bytes', 'slow cycle', 'joint at rest'})
def id_write(case: Case) -> Claims:
    """
    An ID written to two or all, together with the Baud Rate, or lost with the power (WARN).

    Do: connect one servo, write one byte; write 0 to Lock before (Feetech).
    """
    for write in case.report.id_writes:
        found = _writes_to_all(case, write) if len(write.ids) > 1 else _write_to_one(case, write)
        if found is not None:
            yield found


def _writes_to_all(case: Case, write: IdWrite) -> Claim | None:
    lost = [one for one in write.ids if one in case.by_id and case.by_id[one].missed_in_a_row
            and _heard_at(case, one) <= write.stamp]
    is_lost = len(lost) > 1 and sum(case.by_id[one].missed_in_a_row for one in lost) \
        >= INCIDENTS_MIN
    if not (is_lost or _two_answer_at_once(case, write.number)):
        return None
    who = lost if is_lost else write.ids
    return Claim(f'a Write to all (ID {BROADCAST}) gave {first_ids(who, 3)} the ID '
                 f'{write.number:03}: they talk at once; connect one at a time and give '
                 'each its own ID', covers=(*who, write.number))


def _write_to_one(case: Case, write: IdWrite) -> Claim | None:
    number, (old,) = write.number, write.ids
    if _two_answer_at_once(case, number):
        return Claim(f'its answers collide since {old:03} was given this ID: two devices '
                     f'had the ID {old:03}, or another one had this; unplug one, give the '
                     'other its own ID', covers=write.ids, device=number)
    new = case.by_id.get(number)
    if new is None or new.missed_in_a_row < INCIDENTS_MIN:
        return None
    heard = _heard_at(case, number)
    if write.baud >= 0 and not write.back and heard <= write.stamp:
        return Claim(f'never heard: the Write that gave {old:03} this ID went on into its '
                     f'Baud Rate (code {write.baud}), so it is at another rate; write the ID as '
                     'one byte, look for it at other rates', covers=write.ids, device=number)
    if write.back > heard > write.stamp:
        of_lock = '' if case.report.protocol == words.PROTOCOL_2 else \
            ', with 0 in Lock before it and 1 after it (Feetech)'
        return Claim(f'silent, and {old:03}, which was given this ID, answers again: unless '
                     'that is another servo, the ID was lost when its power was off; write it '
                     f'again with its torque off{of_lock}', level=Level.WARN, device=number)
    if write.is_locked and heard > write.stamp and not write.back \
            and FEETECH.name in new.protocol:
        return Claim(f'silent; {old:03} was given this ID without 0 in Lock before, so it '
                     'has its old ID again if its power was off, or it lost its cable; ping '
                     f'{old:03}: if it answers, write 0 to Lock (55), {number} to ID (5), '
                     '1 to Lock', level=Level.WARN, device=number)
    return None


def _two_answer_at_once(case: Case, number: int) -> bool:
    """Tell whether most answers of a device are those of two at once."""
    device = case.by_id.get(number)
    return device is not None and device.window.spoilt >= INCIDENTS_MIN \
        and 2 * device.window.spoilt > device.window.asked \
        and case.damage_picture(device).get('looks like', '').startswith(TWO_SENDERS)


def _heard_at(case: Case, number: int) -> float:
    """Return when a device answered last, 0 if it never did."""
    seconds = case.by_id[number].last_heard_s
    return 0.0 if seconds is None else case.now - seconds * NS_PER_S


def _value_written(case: Case, device: DeviceReport, name: str) -> int:
    """Return what was written, where no model was known then and it says nothing since; or -1."""
    one = case.values[device.id].get(name)
    is_gone = device.id in case.gone or (
        case.failed and device.missed_in_a_row >= INCIDENTS_MIN)
    if one is None or one.source != 'w' or not is_gone or device.model.number is not None \
            or (device.last_heard_s or 0.0) < one.age_s - AFTER_WRITE_S:
        return -1
    return int(one.value.raw)


@Rule(subject='bus',
      symptoms={'two protocols'},
      accounts_for={'stray bytes', 'no packets'})
def protocol_1(case: Case) -> Claims:
    """
    Devices of Protocol 2.0 and of the 1.0 family on one bus.

    Do: set all to one protocol, or use two buses.
    """
    if case.count(ev.PROTOCOL_1) <= 1:
        return
    answered = [device for device in case.devices if device.window.answers]
    of_2 = [device.id for device in answered if device.protocol == words.PROTOCOL_2]
    others = [device for device in answered if device.protocol != words.PROTOCOL_2]
    if not of_2 and case.report.protocol not in ('', words.PROTOCOL_2):
        return                         # all that answer speak the 1.0 family: it is their bus
    name = others[0].protocol if others else UNDECIDED.name
    if len(of_2) < len(others):
        who, host, ids, to = words.PROTOCOL_2, name, of_2, '1.0'
    else:
        who, host, to = name, words.PROTOCOL_2, '2.0'
        ids = [device.id for device in others] \
            or sorted({one.device for one in case.incidents(ev.PROTOCOL_1)})
    remedy = 'give these devices a bus of their own'
    if name != FEETECH.name:           # which has no setting for it
        remedy = f'set these devices to Protocol {to} if they have it, or give them another bus'
    yield Claim(f'{who}, ID {first_ids(ids, 4)}, on a bus of {host}: {remedy}',
                {'packets': case.count(ev.PROTOCOL_1)})


@Rule(subject='bus', level=Level.ERROR,
      symptoms={'unanswered group reads'},
      accounts_for={*SILENCE, 'silent bus', 'slow cycle', 'no acknowledgements',
                    'answers to Pings only'})
def unknown_instruction(case: Case) -> Claims:
    """
    An instruction that this protocol has not, as Sync Read 0x84; nothing answers it.

    WARN beside instructions that it has; advice where it is to all devices, and not 0x84.

    Do: use another instruction; in pypot, `use_sync_read=False`.
    """
    report = case.report
    usual = _usual_instructions(report.protocol)
    strange = [cycle for cycle in report.cycles if usual and cycle.instruction not in usual]
    asks_usual = len(strange) < len(report.cycles)
    for cycle in strange:
        is_of_adapter = cycle.instruction == ADAPTER_READ and report.protocol != words.PROTOCOL_2
        asked = sum(case.times_asked(one) for one in strange
                    if one.instruction == cycle.instruction)
        if asked < (1 if report.failed else INCIDENTS_MIN) or report.kinds.get(
                ev.READ_BY_ADAPTER if is_of_adapter else ev.UNKNOWN_ANSWERED):
            continue
        if not any(device.totals.answers for device in report.devices) and (
                not report.has_sides or any(one.instruction in _ASKING for one in report.cycles)):
            return                         # so that power or rate may be the cause
        what = 'Sync Read 0x84, which only the adapters USB2AX and ArbotiX know: read one ' \
            'servo after the other (pypot: use_sync_read=False)' \
            if is_of_adapter else f'{name_of(cycle.instruction)}, which {report.protocol} does ' \
            'not have: correct the program'
        yield Claim(f'nothing answers {what}', {'asked': asked},
                    None if is_of_adapter or not asks_usual
                    else Level.OK if cycle.ids == (BROADCAST,) else Level.WARN)
        return


@lru_cache(maxsize=8)
def _usual_instructions(protocol: str) -> frozenset[int]:
    """Return what servos of these protocols have; Sync Read has a rule of its own."""
    of_family = [one.entries for one in DIALECTS if one.name in protocol]
    of_2 = NAMES if words.PROTOCOL_2 in protocol else ()
    known = {*of_2}.union(*of_family)
    return frozenset((known | {Instruction.SYNC_READ}) - {ADAPTER_READ} if known else ())


@Rule(subject='bus',
      symptoms={'echo'},
      accounts_for={*TRAFFIC, 'two protocols', 'refused access', 'refused address',
                    'refused value', 'error bits', 'voltage limit', 'joint at rest',
                    'unsent instructions'})
def echo(case: Case) -> Claims:
    """
    Instructions are heard twice; advice where all answers come.

    Do: switch the adapter's echo off.
    """
    if case.has_sides:          # what it says twice it says itself
        least = ECHO_MIN_INSTRUCTIONS
        heard_back, asked = case.increase_of('echoes'), case.increase_of('instructions')
        if case.failed:         # it may have ended on the first
            least, heard_back, asked = 1, case.report.kinds.get(ev.ECHO, 0), \
                case.report.counters['Instructions']
        if heard_back >= least and heard_back > ECHO_MIN_SHARE * asked:
            windows = [one.window for one in case.devices]
            answered = sum(one.answers for one in windows)
            lost = sum(one.missed + one.spoilt for one in windows)
            if not case.failed and answered >= heard_back - lost \
                    and lost <= ECHO_SKIPPED_MAX_LOST * heard_back \
                    and not case.count(ev.STALE) + case.count(ev.TAKEN_FOR):
                yield Claim('the adapter echoes, and answers come after that: all is well if the '
                            'program skips what it sent; else it reads that as answers',
                            {'echoes': heard_back}, Level.OK)
                return
            yield Claim('the master receives what it sends: its adapter echoes; switch the '
                        'echo off, or let the program skip it', {'echoes': heard_back},
                        None if answered else Level.ERROR)
        return
    again = [one for one in case.incidents(ev.REPEATED) if one.detail.us < ECHO_MAX_US]
    answered = sum(cycle.asked > 0 for cycle in case.cycles)
    if answered and len(again) >= ECHO_MIN_INSTRUCTIONS \
            and 2 * len(again) > case.count(ev.REPEATED):
        yield Claim('every instruction is heard twice: the adapter echoes what its master '
                    'sends; switch the echo off. Losses counted here are not real',
                    {'echoes': len(again)})


# --- several senders -----------------------------------------------------------------------------

@Rule(level=Level.ERROR,
      symptoms={'second answers'},
      accounts_for={*DAMAGE, 'damaged first bytes', 'late answers', 'restart', 'unread bytes'})
def duplicate_id(case: Case, device: DeviceReport) -> Found | None:
    """
    Second answers to one question, bytes after its answers alone, or damage only with this ID.

    Do: unplug one of the two, change its ID.
    """
    twice = case.count(ev.SECOND_ANSWER, device)
    if not twice and _alone_answers_again(case, device):
        twice = case.count(ev.ANSWERED_AGAIN, device)
    window = device.window
    models = window.model_changes >= 2 and window.spoilt >= INCIDENTS_MIN
    at_end = case.failed == words.RAISED and twice == case.count(ev.SECOND_ANSWER)
    others = case.count(ev.UNASKED, device) + case.count(ev.LATE, device)
    if _says_too_much(case, device):
        return Claim('more bytes come than its answers have, not so from others: two '
                     'devices have this ID; unplug one and change the ID of the other',
                     {'answers': window.overlong_replies})
    is_enough = twice >= (1 if at_end else INCIDENTS_MIN)
    if case.count(ev.STALE) and not case.count(ev.SPLIT) and _answers_twice(case) == device.id:
        return Claim('of what the program reads too late, twice as much is from this ID: two '
                     'devices have it; unplug one and change the ID of the other, and clear the '
                     'input before each question')
    if not models and not (is_enough and twice >= SECOND_ANSWERS_FACTOR * others):
        return None
    second = case.count(ev.SECOND_ANSWER)
    if (case.count(ev.STALE) >= INCIDENTS_MIN and twice < second) \
            or (case.count(ev.TAKEN_FOR) >= INCIDENTS_MIN and 2 * twice <= second):
        return None                    # several devices: the program reads old answers
    also = ', by two models' if window.model_changes >= 2 else ''
    return Claim(f'answered twice{also}: two devices have this ID; unplug one and '
                 'change the ID of the other',
                 {**case.damage_picture(device),
                  'second answers': twice,
                  'damaged': window.spoilt,
                  'model changes': window.model_changes})


def _answers_twice(case: Case) -> int | None:
    """Return the ID of which whole answers in the noise are too many for the questions to it."""
    seen = Counter(one.device for one in case.incidents(ev.PROTOCOL_1))
    asked: Counter[int] = Counter()
    for cycle in case.cycles:
        if len(cycle.ids) == 1:
            asked[cycle.ids[0]] += cycle.asked
    shares = sorted((times / asked[number], number) for number, times in seen.items()
                    if asked[number])
    if len(shares) < 2:
        return None
    (less, _), (most, number) = shares[-2:]
    return number if seen[number] >= TWIN_MIN_ANSWERS and most > TWIN_MIN_FACTOR * less else None


def _says_too_much(case: Case, device: DeviceReport) -> bool:
    """Tell whether bytes follow the answers of this device alone: a cable only changes them."""
    overlong, asked = device.window.overlong_replies, device.window.asked
    if overlong < max(DUPLICATE_MIN_ANSWERS, DUPLICATE_MIN_SHARE * asked) or case.count(ev.LATE):
        return False
    others = _others_that_answer(case, device, overlong)
    return bool(others) and all(10 * one.window.overlong_replies <= overlong for one in others)


def _others_that_answer(case: Case, device: DeviceReport, times: int) -> list[DeviceReport]:
    return [one for one in case.devices if one is not device and one.window.answers >= times]


def _alone_answers_again(case: Case, device: DeviceReport) -> bool:
    """
    Tell whether damage is where this device has answered, and then it answers once more.

    A question that damage hid looks the same, once; it would be as often one to another device,
    and the damage would hit the answers of others too. What a device of Protocol 1.0 says is
    damage as long as it is not proven to be that.
    """
    again = case.count(ev.ANSWERED_AGAIN, device)
    if not again or case.count(ev.PROTOCOL_1, device):
        return False
    others = _others_that_answer(case, device, again)
    return len(others) > 1 and again == case.count(ev.ANSWERED_AGAIN) \
        and again >= AGAIN_MIN_SHARE * case.damage and not any(one.window.spoilt for one in others)


@Rule(needs_incident=(ev.UNASKED,),
      symptoms={'unasked answers'},
      accounts_for={'second answers', 'missed answers', 'damaged packets', 'damaged answers',
                    'stray bytes', 'damaged first bytes'})
def foreign_answers(case: Case, device: DeviceReport) -> Found | None:
    """
    Answers that this master did not ask for.

    Do: look for another master on a segment that is not monitored.
    """
    unasked = case.count(ev.UNASKED, device)
    if unasked < INCIDENTS_MIN or case.count(ev.PROTOCOL_1, device) \
            or case.count(ev.SECOND_ANSWER) >= SECOND_ANSWERS_FACTOR * unasked:
        return None
    return Claim(f'{unasked} answers that this master did not ask for: another master, '
                 'on a segment that is not monitored; find and stop it',
                 {'answers': unasked})


# --- damage --------------------------------------------------------------------------------------

@Rule(subject='device or bus',
      symptoms={'damaged first bytes'},
      accounts_for={'damaged first bytes', 'stray bytes', 'damaged answers', 'missed answers',
                    'absence'})
def turnaround(case: Case) -> Claims:
    """
    Wrong first byte, right CRC.

    Do: raise Return Delay Time by 2 to 4 us.
    """
    if case.spoilt >= INCIDENTS_MIN:
        yield from _first_bytes_lost(case)
    # How many answers of each were whole but for their first byte.
    first = {one.id: one.window.repaired + one.window.first_byte_lost for one in case.devices
             if one.window.repaired or one.window.first_byte_lost}
    if not first:
        return
    hit = [device for device in case.devices if first.get(device.id, 0) > max(
        INCIDENTS_MIN, TURNAROUND_MIN_SHARE * device.window.answers,
        _first_bytes_by_chance(device.window.spoilt))]
    total = sum(first.values())
    lost = sum(case.by_id[number].window.first_byte_lost for number in first)
    if not hit or (total - lost <= FIRST_BYTE_BY_CHANCE * case.damage and lost <= case.damage) \
            or is_overlaid(case) or (case.has_sides and case.count(ev.CUT) >= total):
        return                         # a program that reads one byte too many cuts it off
    if len(first) > 2 and max(first.values()) < ONE_DEVICE_MIN_SHARE * total:
        answers = sum(_answers_heard(case.by_id[number]) for number in first)
        yield Claim(f'first byte of {share(total, answers)} of the answers damaged, '
                    f'{len(first)} devices: the line switches too late; raise Return Delay '
                    'Time or correct the driver enable',
                    {'answers': total,
                     'packets with a stray byte': case.increase_of('stray_packets'),
                     'devices': all_ids(first)})
        return
    for device in hit:
        yield Claim(f'first byte of {share(first[device.id], _answers_heard(device))} of its '
                    'answers damaged: it answers before the line switches; raise its Return Delay '
                    'Time by a step or two', {'answers': first[device.id]}, device=device.id)


def _first_bytes_lost(case: Case) -> Claims:
    """Look for devices of which all damaged answers lack as many first bytes."""
    noise = case.report.noise
    if FAMILY_HEADER in noise:         # then a header is whole
        return
    found = cut_packets(noise, tuple([one for one in expected_packets(case.report)
                                      if case.by_id[one.device].window.spoilt]))
    if sum(shape.size - lost for shape, lost in found) < CUT_MIN_SHARE * len(noise):
        return
    of_device = Counter([shape.device for shape, _ in found])
    for (number, lost), count in Counter([(shape.device, lost) for shape, lost in found]).items():
        if count >= max(INCIDENTS_MIN, CUT_MIN_SHARE * of_device[number]):
            yield Claim(f'the first {lost} bytes of its answers are missing, the rest is whole: '
                        'the adapter switches to receive too late; raise its Return Delay Time, '
                        'or switch earlier', {'answers': count}, device=number)


def _first_bytes_by_chance(damaged: int) -> float:
    """Return how many first bytes noise hits where so many packets are damaged: rarely more."""
    usual = FIRST_BYTE_BY_CHANCE * damaged
    return usual + 2 * sqrt(usual)


def _answers_heard(device: DeviceReport) -> int:
    """Return how many answers came: those of 1.0 without their first byte were missed."""
    return device.window.answers + device.window.first_byte_lost


@Rule(subject='bus',
      symptoms={'damaged packets'},
      accounts_for={'damaged answers', 'missed answers', 'absence', 'stray bytes',
                    'uneven rhythm', 'wrong length'})
def noise(case: Case) -> Claims:
    """
    Damaged packets of several devices.

    Do: check termination, ground, shield, motor cables.
    """
    yield from _noise_claims(case)
    yield from source_lost(case)
    if 0 < case.damage < NOISE_MIN_PACKETS:
        yield Doubt(f'{case.damage} damaged packets in 10 s are too few to find a cause')


def source_lost(case: Case) -> Iterator[Doubt]:
    """Say how much the source could not hand over."""
    lost = sum(one.detail.number for one in case.incidents(ev.SOURCE_LOST))
    if lost:
        yield Doubt(f'{lost} bytes or events were lost: lost data looks like silence; call '
                    'strace with -s 4096, or take other devices off this USB bus')


def _noise_claims(case: Case) -> Claims:
    packets = case.packets
    if case.damage < max(NOISE_MIN_PACKETS, NOISE_MIN_SHARE * packets) \
            or case.damage_s < DAMAGE_ONSET_S:
        return
    hit = [device.id for device in case.devices if device.window.spoilt]
    asked = _asked_damaged(case)
    if ev.REFUSED in case.incidents_by_kind:           # some of them only a servo saw
        asked += [one.detail.error for one in case.incidents(ev.REFUSED)].count(CRC_ERROR)
    both_ways = asked >= BOTH_WAYS_MIN_SHARE * case.damage
    if not both_ways and _most_hit(case) is not None:
        return
    if is_collision(case) if both_ways else may_overlap(case):
        yield Doubt('packets overlap: two programs, two devices with one ID, or a master '
                    'that does not wait for answers', step=f'{STOP_OTHERS}: if packets still '
                    'overlap, ping each ID while its servo is unplugged: what answers is another')
        return
    way = 'in instructions' if asked == case.damage \
        else 'in both directions' if both_ways else 'in answers'
    share_of = about(case.damage, packets + case.damage)
    picture = case.damage_picture()
    # Interference hits answers too; a second program's instructions meet those of the first.
    is_one_way = asked == case.damage and not case.spoilt and \
        2 * sum(device.window.answers for device in case.devices) >= packets
    if not case.has_sides and (
            is_one_way or (not picture and case.damage < NOISE_SURE_MIN_SHARE * packets)):
        how = 'instructions only' if is_one_way else 'in no clear way'
        yield Doubt(f'{share_of} of the packets damaged, {how}: interference, or a second program',
                    step=f'{STOP_OTHERS}: what is damaged then is interference')
        return
    yield Claim(f'{share_of} of the packets damaged, {way}, of '
                'several devices: check termination, ground, shield, motor cables, baud rate',
                {**picture,
                 'share': share(case.damage, packets + case.damage),
                 'damaged instructions': asked,
                 'devices': all_ids(hit)})


def _asked_damaged(case: Case) -> int:
    """Return how many instructions were damaged; an unknown code was a status."""
    return sum(one.detail.instruction in NAMES for one in case.incidents(ev.DAMAGED_INSTRUCTION))


def _most_hit(case: Case) -> DeviceReport | None:
    """Return the device that has most of all spoilt answers, if there is one."""
    least = max(INCIDENTS_MIN, ONE_DEVICE_MIN_SHARE * case.spoilt)
    return next((device for device in case.devices if device.window.spoilt >= least), None)


@Rule(onset_s=DAMAGE_ONSET_S,
      symptoms={'damaged answers'},
      accounts_for={'missed answers', 'absence', 'stray bytes', 'uneven rhythm', 'wrong length',
                    'joint at rest'})          # its position is seen too rarely
def damaged_answers(case: Case) -> Claims:
    """
    Only its answers are damaged, or bytes that are no packet come in their place.

    Do: unplug it and ping its ID: what still answers is a duplicate; else check its cable.
    """
    worst = _most_hit(case)
    last = case.last_wait
    for device in case.devices if case.failed and worst is None else ():
        if not device.missed_in_a_row or not device.window.spoilt or (
                case.failed != words.RAISED and (last is None or device.id != last.device)):
            continue
        yield Claim('its last answer was damaged, so the program ended: a bad cable, '
                    'or a second device with its ID: it answers a Ping while this one is '
                    'unplugged',
                    is_certain=True, device=device.id)
    if worst is None or _asked_damaged(case) >= \
            BOTH_WAYS_MIN_SHARE * max(case.damage, case.spoilt):
        return
    if case.count(ev.TOO_LONG, worst) >= INCIDENTS_MIN and ran_into_answers(case):
        yield Doubt('the master sends during its answers: it does not wait, or a second one '
                    'sends', worst.id, f'{STOP_OTHERS}: if that goes on, let the program wait 50 '
                    'ms for each answer')
        return
    window = worst.window
    others = ', others whole' if any(
        device.window.answers for device in case.devices if device is not worst) else ''
    yield Claim(f'{about(window.spoilt, window.asked)} of its answers damaged{others}: '
                'a bad cable or a second device with its ID; unplug it and ping its ID',
                {**case.damage_picture(worst),
                 'share': share(window.spoilt, window.asked),
                 'damaged': f'{window.spoilt} of {window.asked}'}, device=worst.id)


@Rule(subject='bus',
      symptoms={'unsent instructions'},
      accounts_for={'silent bus', 'no acknowledgements', 'joint at rest'})
def not_sent(case: Case) -> Claims:
    """
    The adapter did not send what was written.

    Do: switch flow control off; do not flush output after a write.
    """
    count = case.count(ev.NOT_SENT)
    if count >= (1 if case.failed else INCIDENTS_MIN):
        asked = sorted({one.device for one in case.incidents(ev.NOT_SENT)})
        yield Claim(f'{count} instructions never left the adapter: in the program, switch '
                    'flow control off and do not flush output after a write; else plug the '
                    'adapter in again',
                    {'instructions': count, 'to': all_ids(asked)})


@Rule(subject='bus', level=Level.OK,
      symptoms={'stray bytes'})
def stray_bytes(case: Case) -> Claims:
    """
    Harmless bytes before packets; WARN where a program ended on one.

    Do: add bias resistors.
    """
    stray = case.increase_of('stray_packets')
    if stray >= STRAY_PACKETS_MIN and stray > STRAY_PACKETS_MIN_SHARE * case.packets:
        yield Claim(f'one or two stray bytes before {share(stray, case.packets)} of the packets: '
                    'driver enable switches late or the line floats; add bias resistors',
                    {'packets': stray})
    last, spoilt = case.last_wait, sum(one.is_spoilt for one in case.report.waits)
    if case.failed == words.RAISED and last is not None and last.is_spoilt and not last.us \
            and spoilt <= case.report.kinds.get(ev.GLITCH, 0):     # it left the end of no other
        yield Claim('a stray byte before the answer on which the program ended: driver '
                    'enable switches late or the line floats; add bias resistors',
                    {}, Level.WARN)


RULES = (echo, text, wrong_baud, overrun, baud_moved, id_moved, id_write, protocol_1,
    unknown_instruction, duplicate_id, foreign_answers, turnaround, noise, damaged_answers,
    not_sent, stray_bytes)
