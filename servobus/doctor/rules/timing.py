# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Time: who is too early, too late, too slow, out of step.

What is finer than the adapter resolves is not judged: latencies come with their share resolved,
periods are judged in parts of themselves (rhythm.py).
"""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Iterator
from itertools import pairwise
from math import inf
from operator import attrgetter
from statistics import median

from msg_defs.diagnostics import Level
from msg_defs.dxl_instruction import Instruction
from msg_defs.dxl_instruction import name_of
from msg_defs.nanoseconds import NS_PER_MS
from msg_defs.nanoseconds import NS_PER_S
from msg_defs.uart import byte_ns
from servobus.bus import evidence as ev
from servobus.bus.evidence import WAITS_KEPT
from servobus.bus.report import Cycle
from servobus.bus.report import DeviceReport
from servobus.bus.report import Incident
from servobus.bus.report import STOLE_REPLIES
from servobus.doctor.case import Case
from servobus.doctor.case import key_of
from servobus.doctor.facts import count_early_ends
from servobus.doctor.facts import count_early_reads
from servobus.doctor.facts import FACTORY_DELAY_US
from servobus.doctor.facts import fatal_late_answer
from servobus.doctor.facts import first_of_groups
from servobus.doctor.facts import is_collision
from servobus.doctor.facts import is_overlaid
from servobus.doctor.facts import ran_into_answers
from servobus.doctor.facts import SAME_DELAY_NS
from servobus.doctor.facts import WAITS_WINDOW_S
from servobus.doctor.rhythm import answer_ns
from servobus.doctor.rhythm import answered_within_ns
from servobus.doctor.rhythm import EVEN_MAX_SPREAD
from servobus.doctor.rhythm import is_independent
from servobus.doctor.rhythm import is_locked
from servobus.doctor.rhythm import is_multiple
from servobus.doctor.rhythm import percentiles
from servobus.doctor.rhythm import Rhythm
from servobus.doctor.rhythm import WRITES
from servobus.doctor.rule import all_ids
from servobus.doctor.rule import Claim
from servobus.doctor.rule import Claims
from servobus.doctor.rule import Doubt
from servobus.doctor.rule import first_ids
from servobus.doctor.rule import Found
from servobus.doctor.rule import Rule
from servobus.doctor.rule import STOP_OTHERS
from servobus.doctor.symptom import DAMAGE
from servobus.doctor.symptom import SILENCE
from servobus.doctor.thresholds import ADAPTER_HOLD_US
from servobus.doctor.thresholds import BLUR_FACTOR
from servobus.doctor.thresholds import INCIDENTS_MIN
from servobus.doctor.thresholds import LONG_WAIT_MS
from servobus.doctor.thresholds import WINDOW_S

LOAD_BUSY_PERCENT = 75.0           # wire time: the rest leaves no room for a retry
LOAD_WINDOW_S = 3.0                # a few cycles, even of a slow master
RETURN_DELAY_MS = (0.4, 0.7)       # a Return Delay Time of 500 us, as measured
RETURN_DELAY_SPREAD_MS = 0.15      # a delay that is set varies less than one of an adapter
RETURN_DELAY_MIN_ANSWERS = 5       # the spread of fewer is small by chance
JITTER_MIN_SPREAD = 0.5            # relative to the cycle
LATE_CYCLES_MIN = 5                # that no time-out for an answer explains
LATE_CYCLES_MIN_SHARE = 0.02       # share of the cycles; fewer are not felt
LATE_CYCLES_MIN_S = 3.0            # from the first to the last: a start or a pause is shorter
LATE_CYCLES_WITHIN_S = 2.0         # since the last
USUAL_MIN_SHARE = 0.6              # share of the cycles; fewer, and it has no rhythm
JITTER_ONSET_S = 3.0               # a computer that is busy for a moment is not a finding
LATENCY_TIMER_MS = (15.0, 18.5)    # a latency timer of 16 ms, and what its host adds
LATENCY_TIMER_MAX_PER_S = 70       # answers; with 16 ms each there cannot be more
LATENCY_TIMER_MIN_GAPS = 10
LATENCY_TIMER_MIN_SHARE = 0.6      # share of the gaps
RESOLVED_MS = 4.0                  # between chunks; else all gaps count, not those after answers
ADAPTER_GRID_NS = 16 * NS_PER_MS   # exactly that is made by the adapter that we hear through
HZ_60_NS = NS_PER_S // 60
HZ_60_MIN_SHARE = 0.7              # share of those gaps
NO_WAIT_US = 50                    # less than any answer takes on the wire
LATE_ONE_MAX_SHARE = 0.6           # share of what is late: of more, one device is slow
LATE_MIN_SHARE_OF_WAITS = 0.2      # else most are for devices that are silent
THROWN_AWAY_MIN = 10               # answers: a program may clear its input at its start
ACKS_HIT_MIN_SHARE = 0.7           # share of the spoilt answers, which come right after a write
HIT_BY_CHANCE = 0.0015             # that noise hits just the questions after a write
AFTER_WRITE_NS = 2 * NS_PER_MS     # as far as chunks tell time
LATE_MIN_SHARE = 0.02              # share of the answers; a busy computer delays less
CYCLE_MIN_SHARE = 0.5              # share of the cycle: most of it
SINGLE_READS_MIN = 3               # that one Sync Read replaces
GROUP_DELAY_FACTOR = 4             # times the first answer's delay: each servo of a group adds its
SERVO_DELAY_MAX_MS = 2.0           # the longest Return Delay Time is 0.5 ms; and a busy computer
SLOW_ANSWER_MS = 0.4               # reply latency: Return Delay Time from the factory is 0.5 ms


# --- several masters -----------------------------------------------------------------------------

@Rule(subject='bus', level=Level.ERROR, onset_s=1.0,
      symptoms={'two rhythms'},
      accounts_for={*DAMAGE, 'hasty instructions', 'late answers', 'second answers',
                    'unasked answers', 'damaged first bytes', 'absence of several',
                    'wrong length', 'slow cycle', 'unread bytes'})
def two_masters(case: Case) -> Claims:
    """
    Two independent rhythms of instructions.

    Or answers are lost while another program has the port open, two threads read at once, or one
    reads after the other has asked.

    Do: find the second program; give threads one lock.
    """
    foreign = case.count(ev.FOREIGN)
    if foreign >= INCIDENTS_MIN:
        yield Claim(f'the master received {foreign} instructions that it did not send: '
                    'another program uses this bus; stop '
                    'one', {'instructions': foreign})
        return
    lost = sum(one.window.missed for one in case.devices if one.id not in case.gone)
    harm = lost + case.damage + case.count(ev.LATE) + INCIDENTS_MIN * case.count(ev.UNASKED)
    if STOLE_REPLIES in case.report.users or (case.report.users and harm >= INCIDENTS_MIN):
        figures = {'missed answers': lost, 'damaged packets': case.damage}
        yield Claim(f'{", ".join(case.report.users)} uses this port too, and answers get '
                    'lost or damaged: let only one use it',
                    {name: number for name, number in figures.items() if number}, is_certain=True)
        return
    hasty = sum(not one.is_spoilt and one.us < FACTORY_DELAY_US for one in case.waits(WINDOW_S))
    if case.has_sides and min(harm, hasty) < INCIDENTS_MIN:
        return                                 # one program with two timers, or with a lock
    pair = _independent_rhythms(case)
    if pair is not None:
        loops = [_spell_rhythm(one.cycle, one.base) for one in pair]
    elif case.clocks:
        fast, slow = sorted(timer.period for timer in case.clocks[0].timers)
        loops = [_spell_rhythm(case.clocks[0].cycle, fast), f'every {slow / NS_PER_MS:.0f} ms']
    else:
        return
    words = ' and '.join(loops)
    if pair is None and not is_collision(case):
        yield Doubt(f'{words}: two programs, or one with two timers')
        return
    yield Claim(f'{words}: two programs, or two threads without a lock; let only one ask',
                {'damaged packets': case.damage})


def _independent_rhythms(case: Case) -> tuple[Rhythm, Rhythm] | None:
    """Return two instructions that keep time apart from each other."""
    ordered = sorted(case.rhythms, key=attrgetter('base'))
    least = max(BLUR_FACTOR * case.blur_ms, 1.0) * NS_PER_MS
    steady = [one for one in ordered if one.is_steady]
    if not steady or steady[0].base <= least \
            or (steady[0] is not ordered[0] and not is_overlaid(case)):
        return None
    one, *others = steady
    collide = is_collision(case)               # as one program's questions never do
    for other in others:
        differs = collide and not is_locked(other, one)
        if (differs and one is ordered[0]) or (
                (differs or not is_multiple(other, one))
                and is_independent(one, other) and is_independent(other, one)):
            return one, other
    return None


def _spell_rhythm(cycle: Cycle, period: float) -> str:
    whom = f'{cycle.ids[0]:03}' if len(cycle.ids) == 1 else f'{len(cycle.ids)} IDs'
    at = f' at {cycle.address}' if cycle.address is not None else ''
    return f'{name_of(cycle.instruction)} of {whom}{at} every {period / NS_PER_MS:.0f} ms'


# --- a master that does not wait, and answers that are late --------------------------------------

@Rule(subject='bus',
      symptoms={'hasty instructions'},
      accounts_for={*SILENCE, *DAMAGE, 'late answers', 'second answers', 'unasked answers',
                    'silent bus', 'no acknowledgements', 'absence of several', 'restart',
                    'joint at rest'})
def impatient_master(case: Case) -> Claims:
    """
    The master does not wait for the whole answer, or throws answers away unread.

    Do: raise its time-out; let it read them.
    """
    waits = case.report.waits
    since = waits[0].stamp if len(waits) >= WAITS_KEPT else 0      # why is unknown of older ones
    spoilt = [wait.stamp for wait in waits if wait.is_spoilt]      # asked once more
    again = Counter(code for stamp, code in case.repeats.items() if stamp >= since
                    and not any(0 <= stamp - one < SAME_DELAY_NS for one in spoilt))
    again.update(one.detail.instruction for one in _hidden_repeats(case))
    again.update(one.detail.instruction for one in _repeats_into_answers(case))
    # After a stray byte it asks once more.
    if again.total() >= INCIDENTS_MIN + case.increase_of('stray_packets'):
        worst = again.most_common(1)[0][0]
        words = f'the master repeats {name_of(worst)} at once, {again.total()} times in 10 s'
        yield Doubt(f'{words}, though it got whole answers: its parser may reject them') \
            if case.has_sides and not case.waits(WINDOW_S) else \
            Claim(f'{words}: its time-out is shorter than the answers take; raise it',
                  {'repeated': again.total()})
        return
    hasty = count_early_ends(case) or count_early_reads(case)
    if hasty and (_reads_few(case, hasty) if case.has_sides else
                  case.damage >= INCIDENTS_MIN and any(case.recent_counts(
                      device, WAITS_WINDOW_S).answers for device in case.devices)):
        yield Claim('the master does not wait for answers and sends during them: it asks on '
                    f'within {FACTORY_DELAY_US} us, before a servo with factory settings '
                    'answers; let it wait for each answer, also between threads or tasks (a '
                    'lock), and raise its time-out', {'given up at once': hasty})
        return
    thrown = sum(one.detail.instruction not in WRITES for one in case.incidents(ev.THROWN_AWAY))
    if thrown >= THROWN_AWAY_MIN:
        yield Claim(f'the program asks, and throws the answers away unread, {thrown} times '
                    'in 10 s: let it wait for each answer and read it, or not ask',
                    {'answers thrown away': thrown})
        return
    times = _questions_into_acks(case)
    if times:
        yield Claim('the master does not wait for the acknowledgement of a write: its next '
                    f'instruction ran into it {times} times in 10 s; let it wait, or use '
                    'Sync Write',
                    {'instructions into an acknowledgement': times})
        return
    late, wait_us = _answers_after_it_went_on(case)
    if late:
        yield Claim(f'the program goes on {wait_us / 1000:.0f} ms after it asked, and answers '
                    f'come later, {late} times in 10 s (an adapter may hold them back for 16 ms: '
                    f'its latency timer): let it wait {LONG_WAIT_MS} ms for an answer, and clear '
                    'its input before it asks',
                    {'answers after it went on': late})


def _answers_after_it_went_on(case: Case) -> tuple[int, float]:
    """
    Return how often answers came after a wait that is too short for an adapter, and that (us).

    Only where they are taken for something else: an answer to another question, or a return.
    """
    if ev.LATE not in case.incidents_by_kind and ev.STALE not in case.incidents_by_kind:
        return 0, 0.0
    waits = [one.us for one in case.waits(WINDOW_S) if not one.is_spoilt]
    late = Counter(one.device for one in first_of_groups(case.incidents(ev.LATE)))
    times = late.total() + case.count(ev.STALE)
    others = case.count(ev.SECOND_ANSWER) + case.count(ev.UNASKED) + case.count(ev.RETURNED)
    if min(len(waits), times, others) < INCIDENTS_MIN or median(waits) >= ADAPTER_HOLD_US \
            or times < LATE_MIN_SHARE_OF_WAITS * len(waits):
        return 0, 0.0
    is_of_one = max(late.values(), default=0) > LATE_ONE_MAX_SHARE * times
    return 0 if is_of_one and len(case.devices) > 1 else times, max(0.0, median(waits))


def _reads_few(case: Case, hasty: int) -> bool:
    """Tell whether fewer than half of the answers come to a program whole, also later."""
    packets, asked = (case.increase_of(name, WAITS_WINDOW_S) for name in (
        'packets', 'instructions'))
    return len(case.marks) > 1 and 2 * (packets - asked) < hasty and not case.count(ev.STALE)


def _questions_into_acks(case: Case) -> int:
    """
    Return how many answers were spoilt right after a write that nothing acknowledged, else 0.

    Noise would spoil the answers to other questions too; where many questions follow a
    write, the cause is unknown.
    """
    spoilt = [wait.stamp - 1000 * wait.us for wait in case.waits(WINDOW_S) if wait.is_spoilt]
    if len(spoilt) < INCIDENTS_MIN:
        return 0
    writes = sorted([stamp for cycle in case.cycles for stamp in cycle.stamps
                     if cycle.instruction == Instruction.WRITE and not _acknowledges(case, cycle)]
                    + [wait.stamp for wait in case.waits(WINDOW_S)      # it was not out yet
                       if wait.instruction == Instruction.WRITE and wait.us < 0])
    asked = [stamp for cycle in case.cycles if cycle.instruction not in WRITES
             for stamp in cycle.stamps]
    times = sum(_is_after(writes, stamp) for stamp in spoilt)
    usual = sum(_is_after(writes, stamp) for stamp in asked)
    return times if times >= max(INCIDENTS_MIN, ACKS_HIT_MIN_SHARE * len(spoilt)) \
        and (usual / max(1, len(asked))) ** times <= HIT_BY_CHANCE else 0


def _acknowledges(case: Case, cycle: Cycle) -> bool:
    return any(number not in case.by_id or case.by_id[number].acks is not None
               for number in cycle.ids)


def _is_after(writes: list[int], stamp: int) -> bool:
    """Tell whether a write came so shortly before that its answer was still due."""
    at = bisect_right(writes, stamp + AFTER_WRITE_NS)
    return at > 0 and writes[at - 1] >= stamp - AFTER_WRITE_NS


def _repeats_into_answers(case: Case) -> list[Incident[ev.Repetition]]:
    """
    Return the questions asked again while their answers were due, where they ran into them.

    A master that repeats what came back damaged does not.
    """
    if not case.count(ev.TOO_LONG) or not ran_into_answers(case):
        return []
    return [one for one in case.incidents(ev.REPEATED) if any(
        cycle.instruction == one.detail.instruction
        and 1000 * one.detail.us < answered_within_ns(cycle, case.report.baud)
        for cycle in case.cycles)]


def _hidden_repeats(case: Case) -> list[Incident[ev.Code]]:
    """
    Return the first of each group of answers that came again after damage in an answer.

    Behind a damaged instruction they would be its own answers.
    """
    again = case.incidents(ev.ANSWERED_AGAIN)
    first = first_of_groups(again)
    return first if len({one.device for one in again}) > 1 \
        and len(first) >= 2 * case.count(ev.DAMAGED_INSTRUCTION) else []


@Rule(symptoms={'late answers'},
      accounts_for={*DAMAGE, 'unasked answers', 'damaged first bytes', 'slow cycle'})
def late_answers(case: Case) -> Claims:
    """
    The answer comes after the master gave up.

    Do: lower Return Delay Time, or raise the time-out.
    """
    fatal = fatal_late_answer(case)
    first = Counter(one.device for one in first_of_groups(case.incidents(ev.LATE)))
    for number, count in [(fatal.device, 1)] if fatal else first.most_common(1):
        device = case.by_id.get(number)
        if not fatal and (count < INCIDENTS_MIN or (device is not None and (
                device.window.not_served >= count
                or count < LATE_MIN_SHARE * device.window.asked))):
            return
        if not fatal and sum(one.device != number for one in case.incidents(
                ev.SECOND_ANSWER)) >= count:
            return                     # two with another ID: a second answer takes its turn
        if _is_cut_short(case):
            yield Doubt('the next instruction comes during its answers: two programs, one '
                        'that does not wait, or two devices with this ID', number,
                        f'{STOP_OTHERS}: if that goes on, let the program wait 50 ms for each '
                        'answer; if it still does, two devices have this ID')
        else:
            known = [one.us for one in case.report.waits]
            also = sorted(one for one, times in first.items()
                          if times >= INCIDENTS_MIN and one != number)
            yield Claim('answers after the master gave up, during the next instruction'
                        f'{f", as {first_ids(also, 2)} do" if also else ""}: raise the time-out, '
                        'or lower its Return Delay Time',
                        {'late answers': count, 'waits': f'{median(known) / 1000:.1f} ms'
                            if known else 'unknown', **({'also': all_ids(also)} if also else {})},
                        covers=tuple(case.by_id), device=number)


def _is_cut_short(case: Case) -> bool:
    """Tell whether questions came as no wait for an answer ends, so that none was given up."""
    waits = [one.us for one in case.waits(WINDOW_S) if not one.is_spoilt]
    return bool(waits) and median(waits) < (
        FACTORY_DELAY_US if case.has_sides else NO_WAIT_US)


@Rule(needs_incident=(ev.WRONG_SIZE,),
      symptoms={'wrong length'})
def wrong_length(case: Case, device: DeviceReport) -> Found | None:
    """
    Answers of the wrong length.

    Do: update its firmware; look for a second device with this ID.
    """
    wrong = case.incidents(ev.WRONG_SIZE, device)
    if len(wrong) < INCIDENTS_MIN or 4 * case.count(ev.LATE, device) > len(wrong):
        return None
    size, asked = wrong[-1].detail.got, wrong[-1].detail.wanted
    return Claim(f'answers {size} bytes to a read of {asked}: its firmware is at '
                 'fault, or a second device has its ID; update it, then unplug it and ping its ID',
                 {'answers': len(wrong)})


# --- slow adapters, devices and lines ------------------------------------------------------------

@Rule(subject='bus',
      symptoms={'slow answers'},
      accounts_for={'uneven rhythm', 'slow cycle'})
def latency_timer(case: Case) -> Claims:
    """
    Instructions come 16 ms after the last answer.

    Do: set the latency timer of the master's adapter to 1 ms.
    """
    if case.report.cycle is not None and case.report.cycle.asleep > case.report.cycle.device:
        return                                 # when the answers came is unknown
    if case.has_sides:
        yield from _answers_held_back(case)
        return
    answers = [answer_ns(cycle, case.report.baud) for cycle in case.cycles]
    answered = sum(len(cycle.stamps) - bisect_right(cycle.stamps, case.now - NS_PER_S)
                   for cycle, answer in zip(case.cycles, answers, strict=True) if answer)
    if answered > LATENCY_TIMER_MAX_PER_S + 1:     # before all is sorted: it is a fast bus
        return
    # In one chunk a write comes first: a question would have had to wait for its answer.
    stamps = sorted((stamp, answers[number], number)
                    for number, cycle in enumerate(case.cycles)
                    for stamp in cycle.stamps if stamp > case.now - NS_PER_S)
    is_coarse = case.blur_ms > RESOLVED_MS
    gaps = [((number, following), two - one, answer)
            for (one, answer, number), (two, _, following) in pairwise(stamps)
            if answer or is_coarse]
    if len(gaps) > LATENCY_TIMER_MAX_PER_S:
        return
    latent = [(kinds, gap) for kinds, gap, answer in gaps if any(
        LATENCY_TIMER_MS[0] <= rest / NS_PER_MS <= LATENCY_TIMER_MS[1]
        for rest in (gap, gap - answer))]
    if is_coarse and all(
            abs(gap - ADAPTER_GRID_NS) < ADAPTER_GRID_NS // 1000 for _, gap in latent):
        return
    if latent and sum(abs(gap - HZ_60_NS) < HZ_60_NS // 100 for _, gap in latent) \
            >= HZ_60_MIN_SHARE * len(latent):
        yield Doubt('instructions come every 16.7 ms: a loop at 60 Hz, or a latency timer '
                    'of 16 ms in the adapter of the master')
        return
    if len(latent) >= max(LATENCY_TIMER_MIN_GAPS, LATENCY_TIMER_MIN_SHARE * len(gaps)) \
            and any(number != following for (number, following), _ in latent):
        yield Claim('most instructions come 16 ms after the previous answer: the latency '
                    "timer of the master's adapter; set it to 1 ms",
                    {'16 ms later': f'{len(latent)} of {len(gaps)}'})


def _answers_held_back(case: Case) -> Claims:
    """Look at when answers come to the master: no Return Delay Time is longer than 0.5 ms."""
    known = [one.latency.window.p50 for one in case.devices if one.latency.window is not None
             and one.latency.window.count >= LATENCY_TIMER_MIN_GAPS]
    held = [ms for ms in known if LATENCY_TIMER_MS[0] <= ms <= LATENCY_TIMER_MS[1]]
    if held and len(held) >= LATENCY_TIMER_MIN_SHARE * len(known):
        yield Claim("answers come 16 ms after the instruction: the latency timer of the master's "
                    'adapter; set it to 1 ms', {'reply latency (ms)': f'{median(held):.1f}'})


@Rule(subject='bus',
      symptoms={'busy line'},
      accounts_for={'uneven rhythm', 'two rhythms', 'hasty instructions', 'slow cycle'})
def bus_too_slow(case: Case) -> Claims:
    """
    Busy for 75 % of the time, and damage or answers missed now and then.

    Do: raise the baud rate, read less.
    """
    seconds = (case.now - case.mark(LOAD_WINDOW_S).stamp) / NS_PER_S
    got = case.increase_of('bytes', LOAD_WINDOW_S)
    if seconds < 1.0:
        return
    load = 100 * got * byte_ns(case.report.baud) / NS_PER_S / seconds
    if load > LOAD_BUSY_PERCENT:
        steady = next(iter(case.rhythms), None)
        per_cycle = '' if steady is None else \
            f', {got / seconds * steady.period / NS_PER_S:.0f} bytes per cycle'
        harm = case.damage or any(device.window.missed and not device.missed_in_a_row
                                  for device in case.devices)      # one is not just dead
        yield Claim(f'the line is busy for more than {LOAD_BUSY_PERCENT:.0f} % of the '
                    f'time{per_cycle}: no room for a retry; raise the baud rate, or read less',
                    {'load (%)': f'{load:.0f}', 'bytes per second': f'{got / seconds:.0f}'},
                    Level.WARN if harm else Level.OK)


@Rule(level=Level.OK,
      symptoms={'slow answers'},
      accounts_for={'slow cycle'})
def return_delay(case: Case, device: DeviceReport) -> Found | None:
    """
    Return Delay Time is 0.4 ms or more.

    Do: write 0.
    """
    register = case.values[device.id].get('Return Delay Time')
    low, high = RETURN_DELAY_MS
    delay_ms, how, source = _measured_ms(device), 'reply latency', 'measured'
    if register is not None and register.value.number is not None:
        delay_ms, how, source = 1000 * register.value.number, 'Return Delay Time', 'yes'
        high = inf
    if not low <= delay_ms <= high:
        return None
    rate = device.totals.reads / case.heard_s if case.heard_s > 0 else 0.0
    return Claim(f'waits {delay_ms:.1f} ms before each answer ({how}): write 0 to Return '
                 f'Delay Time, which saves {delay_ms * rate:.0f} ms of bus time per second',
                 {'delay (ms)': f'{delay_ms:.2f}', 'read': source})


def _measured_ms(device: DeviceReport) -> float:
    """Return how long it waits before each answer, 0 where that varies."""
    summary = device.latency.window or device.latency.total
    return 0.0 if summary is None or summary.count < RETURN_DELAY_MIN_ANSWERS \
        or summary.p95 - summary.p50 > RETURN_DELAY_SPREAD_MS else summary.p50


# --- the cycle of the master ---------------------------------------------------------------------

@Rule(subject='bus', onset_s=JITTER_ONSET_S,
      symptoms={'uneven rhythm'},
      accounts_for={'uneven rhythm', 'slow cycle'})
def jitter(case: Case) -> Claims:
    """
    A regular loop lost its rhythm.

    Do: real-time priority; take slow work out of the loop.
    """
    rhythms = case.rhythms
    if not rhythms or case.waits(WAITS_WINDOW_S):
        return
    fastest = min(one.base for one in rhythms)
    often = [one for one in rhythms if one.base <= 2 * fastest]
    if min(one.spread for one in often) <= JITTER_MIN_SPREAD:
        return
    best = min(often, key=attrgetter('jitter'))
    low, _, high = (period / NS_PER_MS for period in percentiles(best.periods))
    if best.jitter > JITTER_MIN_SPREAD and high - low > BLUR_FACTOR * case.blur_ms \
            and (key_of(best.cycle) in case.steady or best.is_paced):
        yield Claim("the master's cycle is no longer regular: its computer is busy, or its "
                    'loop does too much; give it a higher priority',
                    {'spread': f'{best.spread:.2f}',
                     'cycle (ms)': f'{low:.1f} to {high:.1f}, '
                                   f'usually {best.period / NS_PER_MS:.1f}'})


@Rule(subject='bus',
      symptoms={'uneven rhythm'},
      accounts_for={'slow cycle'})
def late_cycles(case: Case) -> Claims:
    """
    A few cycles of a regular loop begin late.

    Where it makes up for that: needs a source that knows who sent what.

    Do: as for `jitter`.
    """
    late, least = case.late, max(LATE_CYCLES_MIN, LATE_CYCLES_MIN_SHARE * len(case.loop) + 1)
    if len(late) - len(case.waits(WINDOW_S)) < least \
            or late[-1] - late[0] < LATE_CYCLES_MIN_S * NS_PER_S \
            or late[-1] < case.stamp_ago(LATE_CYCLES_WITHIN_S):
        return
    periods = sorted(period for _, period in case.loop)
    middle = periods[len(periods) // 2]
    usual = sum(abs(one - middle) < EVEN_MAX_SPREAD * middle for one in periods)
    if usual < USUAL_MIN_SHARE * len(periods):
        return
    rank = 95 if len(late) > 0.05 * len(periods) else 98
    high = periods[-1 - len(periods) * (100 - rank) // 100]
    yield Claim(f'the loop is {middle / NS_PER_MS:.1f} ms a cycle at the median, '
                f'{high / NS_PER_MS:.0f} ms at the {rank}th percentile: a busy computer, or slow '
                'work in it; give it a higher priority',
                {'late cycles': f'{len(late)} of {len(periods)}',
                 'longest (ms)': f'{periods[-1] / NS_PER_MS:.1f}'})


@Rule(subject='bus or device', level=Level.OK, onset_s=1.0,
      symptoms={'slow cycle'})
def cycle_time(case: Case) -> Claims:
    """
    More than half of each cycle is one thing that could be faster.

    It is work of the program (not a pause between cycles), answers that wait for it to read,
    waiting for one device, or slow exchanges. Needs a source that knows who sent what.

    Do: what the finding says.
    """
    times = case.report.cycle
    if times is None or times.unknown:
        return
    most = CYCLE_MIN_SHARE * times.cycle
    of_loop = [one for one in case.rhythms if one.period < 2 * NS_PER_MS * times.cycle]
    if times.asleep > most:
        yield Claim(f'{times.asleep:.0f} of {times.cycle:.0f} ms of each cycle the program lets '
                    'answers wait: let it read at once as many bytes as come, with a time-out; '
                    'not sleep before it reads, nor ask for more bytes than an answer has')
    elif times.program > most:
        works = times.busy is None or 2 * times.busy > times.program
        if of_loop and works and not any(one.may_sleep for one in of_loop):
            yield Claim('most of each cycle is the program itself, between an answer and '
                        'the next instruction: do less there, or in another thread')
    elif times.waiting and times.waiting[0][1] > most and times.waiting[0][0] in case.gone:
        yield Claim('most of each cycle is a time-out for its answer: leave '
                    'it out, or shorten the time-out', device=times.waiting[0][0])
    elif times.wire + times.device > most:
        yield from (Claim(todo) for todo in _faster_ways(case, 2 * NS_PER_MS * times.cycle))


def _faster_ways(case: Case, within_ns: float) -> Iterator[str]:
    """Yield what makes the exchanges of a cycle faster; what is asked less often is none."""
    alike = Counter((one.address, one.length) for one in case.cycles
                    if one.instruction == Instruction.READ and 2 * one.missed < one.asked
                    and one.stamps[-1] - one.stamps[0] < within_ns * len(one.stamps))
    reads = max(alike.values(), default=0)
    slow = max((one.latency.window.p50 for one in case.devices if one.latency.window
                and one.latency.window.count >= RETURN_DELAY_MIN_ANSWERS), default=0.0)
    if reads >= SINGLE_READS_MIN and '1.0' not in case.report.protocol:     # it has no Sync Read
        yield (f'{reads} servos are read one by one, which is most of each cycle: use one Sync '
               'Read for all')
    elif slow > SLOW_ANSWER_MS:
        times = case.report.cycle
        is_of_servos = times is not None and slow < SERVO_DELAY_MAX_MS \
            and times.device > GROUP_DELAY_FACTOR * slow
        first = '' if is_of_servos else 'set the latency timer of the adapter to 1 ms, and '
        yield f'most of each cycle is waiting for answers that do come: {first}write 0 to ' \
            'Return Delay Time of the servos'


RULES = (two_masters, impatient_master, late_answers, wrong_length, latency_timer, bus_too_slow,
    jitter, late_cycles, return_delay, cycle_time)
