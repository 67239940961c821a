# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The rooms of the bus at their edges: limits on both sides, words of the log, bounds."""

from pathlib import Path

from doctor_case import notes_of
import pytest
import yaml

from msg_defs.dxl_instruction import Access
from msg_defs.dxl_instruction import ADAPTER_READ
from msg_defs.dxl_instruction import Answers
from msg_defs.dxl_instruction import Instruction as I
from msg_defs.dxl_instruction import Request
from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import Framer
from msg_defs.dxl_packet import STATUS
from msg_defs.event import IN
from msg_defs.event import OUT
from msg_defs.servo_frame import EITHER_1
from msg_defs.servo_frame import Flaw
from msg_defs.servo_frame import INSTRUCTION_1
from msg_defs.servo_frame import INSTRUCTION_2
from msg_defs.servo_frame import IS_STATUS
from servobus.bus import evidence as ev
from servobus.bus import unread
from servobus.bus.decoder import BusDecoder
from servobus.bus.device import Device
from servobus.bus.evidence import Evidence
from servobus.bus.evidence import text_of
from servobus.bus.expected_devices import Expected
from servobus.bus.id_confirmation import IdConfirmation
from servobus.bus.instruction_plans import NO_PLAN
from servobus.bus.instruction_plans import Planner
from servobus.bus.plan import Due
from servobus.bus.plan import ignore_data
from servobus.bus.plan import Plan
from servobus.bus.plan import Slot
from servobus.bus.registry import DeviceRegistry
from servobus.bus.reply_policy import OpenQuestion
from servobus.bus.reply_policy import ReplyPolicy
from servobus.bus.report import Wait
from servobus.bus.table import NO_SPAN
from servobus.bus.table import READ
from servobus.bus.table import Table
from servobus.bus.tracker import Tracker
from servobus.model.control_table import Cases
from servobus.model.control_table import Field
from servobus.model.control_table import Model
from servobus.model.models import Models

ROWS = yaml.safe_load(
    Path(__file__).with_name('bus_edges.yaml').read_text(encoding='utf-8'))

MODELS = Models()
S = 1_000_000_000
MS = 1_000_000


def registry(*expected, baud=1_000_000):
    return DeviceRegistry(MODELS, expected, baud, Evidence())


def notes(one):
    return [(note.kind, note.device, note.detail) for note in one._evidence.incidents]


# --- the log ---------------------------------------------------------------------------------

INCIDENTS = yaml.safe_load(
    Path(__file__).with_name('incidents.yaml').read_text(encoding='utf-8'))


@pytest.mark.parametrize('row', INCIDENTS, ids=lambda row: row['what'])
def test_what_happened_in_words(row):
    row = {**row}
    text = row.pop('text')
    [incident] = notes_of(**row)
    assert text_of(incident) == text
    evidence = Evidence()
    evidence.add_incident(1, incident.kind, 0, *incident.detail)
    evidence.add_incident(2, incident.kind, -1, *incident.detail)
    lines = [one.text for one in evidence.errors(lambda device, address: str(address))]
    assert lines == [f'000: {text}', text] * bool(text)


def test_the_log_keeps_the_last_50_and_the_doctor_the_last_1000_and_256_waits():
    evidence = Evidence()
    for stamp in range(1001):
        evidence.add_incident(stamp, ev.ALERT, 1)
        evidence.waits.append(Wait(stamp, 1, 1, False))
    assert [evidence.errors(lambda *_: '')[at].stamp for at in (0, -1)] == [951, 1000]
    assert len(evidence.errors(lambda *_: '')) == 50
    assert len(evidence.incidents) == 1000 and evidence.incidents[0].stamp == 1
    assert evidence.counts[ev.ALERT] == evidence.incidents_added == 1001
    assert [one.stamp for one in evidence.newest_incidents(2)] == [999, 1000]
    assert len(evidence.newest_incidents(2000)) == 1000
    assert evidence.newest_incidents(0) == ()
    assert [one.stamp for one in evidence.waits] == list(range(745, 1001))


def test_what_may_come_with_each_packet_is_kept_once_in_a_while():
    evidence = Evidence()
    stamps = (0, ev._FREQUENT_APART_NS - 1, ev._FREQUENT_APART_NS, 2 * ev._FREQUENT_APART_NS - 1)
    for stamp in stamps:
        evidence.add_frequent(stamp, ev.PROTOCOL_1, 1, 2)
    assert [one.stamp for one in evidence.incidents] == [0, ev._FREQUENT_APART_NS]
    assert evidence.counts[ev.PROTOCOL_1] == 4


@pytest.mark.parametrize(('kind', 'code', 'reason', 'expected', 'side'), [
    (INSTRUCTION_2, 0, 'crc', (ev.DAMAGED_INSTRUCTION, 7, ev.PacketHeader(0, 259)), IN),
    (IS_STATUS, 9, 'crc', (ev.DAMAGED_STATUS, 7, ev.PacketHeader(0x55, 259)), IN),
    (INSTRUCTION_2, 2, 'length', (ev.BAD_LENGTH, -1, ev.Length(259)), IN),
    (INSTRUCTION_2, 2, 'cut', (ev.CUT, -1, ev.PacketHeader(2, 259)), IN),
    (INSTRUCTION_2, 2, 'crc', (ev.WRONG_PACKET, 7, ev.Code(2)), OUT),
    (EITHER_1, 2, 'open', (ev.UNDECIDED_PACKET, 7, ev.Code(2)), IN),
])
def test_a_damaged_frame_is_noted_by_what_is_wrong(kind, code, reason, expected, side):
    evidence = Evidence()
    flaw = Flaw(reason, length=259)
    evidence.add_damage(1, (0, 9, kind, 7, code, b'', flaw), flaw, side)
    [found] = evidence.incidents
    assert (found.kind, found.device, found.detail) == expected


@pytest.mark.parametrize(('noise', 'fresh', 'devices'), ROWS['noise'])
def test_packets_of_protocol_1_in_noise(noise, fresh, devices):
    evidence = Evidence()
    evidence.search_noise(bytes.fromhex(noise), fresh, 5)
    assert [(one.stamp, one.kind, one.device, one.detail) for one in evidence.incidents] \
        == [(5, ev.PROTOCOL_1, number, ev.Code(0)) for number in devices]


# --- devices ---------------------------------------------------------------------------------


@pytest.mark.parametrize(('after_ns', 'is_late'), [(99_999_999, True), (100_000_000, False)])
def test_an_answer_is_owed_for_a_tenth_of_a_second(after_ns, is_late):
    device = Device(1)
    assert not device.accept_late_reply(0)
    device.count_missed(5 * S, 5 * S, False)
    device.count_missed(5 * S, 5 * S + 99_999_999, False)
    assert device.owed == 2
    assert device.accept_late_reply(5 * S + 99_999_999 + after_ns) is is_late
    device.count_missed(6 * S, 6 * S, True)
    assert device.owed == 0                        # long ago, and this one came damaged
    assert (device.missed_in_a_row, device.counts.missed, device.counts.spoilt) == (3, 3, 1)


@pytest.mark.parametrize(('away_ms', 'is_noted'), [(49.9, False), (50, True)])
def test_an_absence_is_noted_from_50_ms_on(away_ms, is_noted):
    one = registry(Expected(4, 'XL430-W250'))
    device = one.device(4)
    one.accept_status(device, 0, S)
    device.table.store(64, b'\1', S, READ)
    one.accept_status(device, 0, 2 * S)                    # it was not asked: no absence
    device.count_missed(2 * S, 2 * S, False)
    one.accept_status(device, 0, 2 * S + int(away_ms * MS))
    assert notes(one) == [(ev.RETURNED, 4, ev.SilentFor(50, 1, 1))] * is_noted
    assert device.missed_in_a_row == 0


def test_an_id_that_no_device_can_have_gets_none():
    one = registry()
    assert one.device(252).number == 252
    assert one.device(253) is one.device(255)
    assert list(one.devices) == [252]
    assert [one.is_impossible_id(number) for number in (252, 253, 254, 255)] \
        == [False, True, False, True]
    one.store_error_bits(253, 30, 1, S)
    assert list(one.devices) == [252]
    one.store_error_bits(251, 30, 1, S)
    assert one.devices[251].table.bytes(30, 1) == b'\1'


def test_who_says_the_same_of_himself_again_stays_who_he_is():
    one = registry()
    device, outdated = one.device(4), []
    for data in (b'\x24\x04\x2e', b'\x24\x04\x2e'):
        device.accept_pong(NO_SPAN, data, S, READ)
        one.resolve(device)
        outdated.append(not one.plans_hold)
        one.plans_hold = True
    assert (device.counts.pongs, outdated, device.firmware) == (2, [True, False], 0x2e)
    device.table.store(132, bytes(4), S, READ)
    one.register_write(device, 116, b'\1', S)
    device.accept_pong(NO_SPAN, b'\x24\x04\x2f', S, READ)                # new firmware
    one.resolve(device)
    assert (one.plans_hold, device.firmware, notes(one)) == (False, 0x2f, [])
    assert device.table.bytes(132, 1) == b'\0'
    device.accept_pong(NO_SPAN, b'\x37\x01\x2f', S, READ)                # another servo
    one.write_registered(device, S)                # it never heard the Reg Write
    assert device.table.bytes(116, 1) is None
    assert device.model_number == 0x137
    assert (device.counts.model_changes, device.table.bytes(132, 1)) == (1, None)
    device.accept_pong(NO_SPAN, b'', S, READ)
    device.identify(b'\x38\x01', S)           # it was read
    assert device.counts.pongs == 5


def test_a_device_that_also_speaks_the_1_0_family_keeps_its_table():
    one = registry()
    device = one.device(4)
    device.table.store(132, b'\0\x08\0\0', S, READ)
    device.accept_pong(NO_SPAN, b'\x37\x01\x2f', S, READ)
    one.set_device_dialect(device)         # which of them is not known, nor its Model Number
    one.resolve(device)
    assert (device.model.name, device.table.bytes(132, 4)) == ('MX-64', b'\0\x08\0\0')


def test_an_offset_is_noted_when_it_changes():
    one = registry(Expected(2, 'STS3215'))
    for value in (0, 7, 7, 9):
        one.write(one.device(2), 31, bytes([value, 0]), S)
    assert notes(one) == [(ev.OFFSET_WRITTEN, 2, ev.Offsets(7, 0, 0)),
                          (ev.OFFSET_WRITTEN, 2, ev.Offsets(9, 7, 0))]
    one.write(one.device(2), 40, b'\x7f', S)
    assert len(notes(one)) == 2
    one.write(one.device(2), 40, b'\x80', S)
    assert notes(one)[2:] == [(ev.CALIBRATED, 2, ev.NoDetail())]


# --- the table -------------------------------------------------------------------------------

def test_a_span_that_is_long_or_one_too_many_is_put_in_place_at_once():
    table = Table()
    for at in range(64):
        table.store(at, b'\1', S, READ)
    assert len(table._latest) == 64
    table.store(63, b'\2', S, READ)
    assert len(table._latest) == 64
    table.store(64, b'\1', S, READ)
    assert table._latest == {}
    table.store(0, bytes(256), S, READ)
    assert len(table._latest) == 1
    table.store(0, bytes(257), S, READ)
    assert table._latest == {}


def test_nothing_is_kept_from_the_limit_on():
    table = Table()
    table.limit = 10
    table.store(8, b'\1\2\3\4', S, READ)
    table.store(10, b'\5', S, READ)
    table.store(12, b'\5', S, READ)
    assert [table.bytes(at, 1) for at in (7, 8, 9, 10)] == [None, b'\1', b'\2', None]
    assert [table.bytes(8, 2), table.bytes(8, 3), table.bytes(7, 2)] == [b'\1\2', None, None]


def test_a_register_has_the_meaning_that_another_gives_it():
    model = MODELS.by_name('XL430-W250')
    table, raw = Table(), model.by_name['Profile Velocity']
    assert table.resolve_cases(raw, model) is raw           # Drive Mode was not seen
    for mode, of in ((b'\x04', 4), (b'\x01', 0), (b'\x05', 4)):
        table.store(10, mode, S, READ)
        assert table.resolve_cases(raw, model) is raw.cases.fields[of]


def test_a_register_that_decides_is_read_in_its_order_of_bytes():
    cases = Cases('Mode', 0xFFFF, {1: Field(2, 'Goal', 'u8', unit='rad')})
    model = Model(None, 'Arm', (Field(0, 'Mode', 'u16', byte_order='big'),
                                Field(2, 'Goal', 'u8', cases=cases)))
    table = Table()
    table.store(0, b'\0\1', S, READ)
    assert table.resolve_cases(model.by_name['Goal'], model).unit == 'rad'


# --- who must answer -------------------------------------------------------------------------

def due(level, asked, write_acks='auto', acks=None, missing=0, missed=0):
    one = registry()
    device = one.device(3)
    device.return_level, device.acks = level, acks
    device.acks_missing, device.missed_in_a_row = missing, missed
    duty = ReplyPolicy(write_acks, 4, one, one._evidence)
    return duty.judge_silence(Slot(device, asked, NO_SPAN, 0, ignore_data))


@pytest.mark.parametrize(('parts', 'expected'), ROWS['due'])
def test_whether_an_answer_had_to_come(parts, expected):
    level, asked, *more = parts
    assert due(level, Due[asked], *more) is expected


def test_the_first_miss_and_the_one_over_the_limit_are_noted():
    one = registry()
    plan = Plan(Request(I.READ, 3, Answers.DATA, (Access(3, 132, 4, b''),)), {})
    slot = Slot(one.device(3), Due.READ, (132, 4), 4, ignore_data)
    for turn in range(7):
        ReplyPolicy('auto', 4, one, one._evidence).judge_question(
            OpenQuestion(plan, [slot], set(), False), turn, turn)
    assert notes(one) == [(ev.MISSED, 3, ev.Unanswered(I.READ, 132)),
                          (ev.DISCONNECTED, 3, ev.Count(5))]
    assert [note.stamp for note in one._evidence.incidents] == [0, 4]
    assert (plan.missed, one.device(3).counts.data_missed) == (7, 7)


class UnreadRun:
    """A question about 4 bytes of device 3, and what a tap reports of the program that asked."""

    def __init__(self):
        self.registry = registry()
        evidence = self.registry._evidence
        self.unread = unread.UnreadAnswers(
            self.registry, evidence, ReplyPolicy('auto', 4, self.registry, evidence))
        self.slot = Slot(self.registry.device(3), Due.READ, (132, 4), 4, ignore_data)
        self.plan = Plan(Request(I.READ, 3, Answers.DATA, (Access(3, 132, 4, b''),)),
                         {3: self.slot})
        self.question = OpenQuestion(self.plan, [self.slot], set(), False, S)

    def go_to(self, state):
        if state != unread.PENDING:
            self.unread._questions[state].append(self.question)

    def state(self):
        return next((state for state, questions in self.unread._questions.items()
                     if self.question in questions), unread.DONE)

    def next_question(self, waiting=0, purged=False, unsent=False):
        if purged:
            self.purge()
        if waiting:
            self.unread.report_waiting(waiting, 0, S)
        if unsent:
            self.unread.report_unsent(S, S)
        return unread.MISSED if self.unread.end_question(self.question, 2 * S) else ''

    def purge(self, waiting=0):
        self.unread.report_waiting(waiting, 0, S)
        self.unread.report_purge(NO_PLAN, {}, 2 * S, 0, 2 * S)

    def hear_answer(self, flaw=None):
        self.unread.take_old_answers(
            [(0, 15, IS_STATUS, 3, 0, bytes(4), flaw)], 2 * S, 15, NO_PLAN)

    def events(self):
        return {
            unread.NOT_SENT: lambda: self.next_question(unsent=True),
            unread.WAITED: self.next_question,
            unread.NOT_READ: lambda: self.next_question(waiting=3),
            unread.NOT_READ_PURGED: lambda: self.next_question(waiting=3, purged=True),
            unread.ANSWERED: self.hear_answer,
            unread.DAMAGED: lambda: self.hear_answer(Flaw('crc')),
            unread.EXPIRED: lambda: self.unread.judge_expired(2 * S),
            unread.PURGED: lambda: self.purge(7),
            unread.PURGED_NOTHING: self.purge,
            unread.CLOSED: lambda: self.unread.close(self.question, 2 * S),
            unread.LOST: lambda: self.unread.close(None, 2 * S),
        }


@pytest.mark.parametrize(('state', 'event', 'then'), [
    (state, event, then) for state, row in unread.NEXT.items() for event, then in row.items()])
def test_a_question_that_is_over_moves_as_the_table_says(state, event, then):
    run = UnreadRun()
    run.go_to(state)
    returned = run.events()[event]()
    is_missed = returned == unread.MISSED or run.registry.device(3).counts.missed == 1
    assert (unread.MISSED if is_missed else run.state()) == then


def test_what_waited_is_gone_with_the_port():
    run = UnreadRun()
    run.unread.report_waiting(15, 0, S)
    run.unread.close(run.question, S)
    answer = [(0, 15, IS_STATUS, 3, 0, bytes(4), None)]
    assert run.unread.take_old_answers(answer, 2 * S, 15, NO_PLAN) == answer
    run.unread.judge_last(9 * S, True)                     # it waited, so the program did not hang
    assert [kind for kind, *_ in notes(run.registry)] == [ev.LEFT_OPEN]


def test_an_old_answer_under_an_id_that_none_has_is_no_devices():
    run = UnreadRun()
    run.unread.report_waiting(15, 0, S)
    answer = [(0, 11, IS_STATUS, 253, 0x80, b'', None)]
    assert run.unread.take_old_answers(answer, 2 * S, 11, NO_PLAN) == answer
    assert (run.registry.device(253).heard, notes(run.registry)) == (0, [])


@pytest.mark.parametrize(('idle_ns', 'missed'), [(S, 0), (S + 1, 1)])
def test_an_answer_is_given_up_behind_an_idle_line_of_more_than_a_second(idle_ns, missed):
    one = BusDecoder(MODELS)
    one.process_chunk(encode(3, I.READ, b'\x84\0\4\0'), S)
    one.process_pause(S, S + idle_ns)
    assert one.registry.devices[3].counts.missed == missed


def plan_of(*numbers):
    return Plan(Request(I.SYNC_READ, 254, Answers.DATA, tuple(
        Access(number, 132, 4, b'') for number in numbers)), {
            number: Slot(Device(number), Due.READ, (132, 4), 4, ignore_data)
            for number in numbers})


@pytest.mark.parametrize(('silent', 'spoke', 'expected'), ROWS['turn'])
def test_who_had_its_turn(silent, spoke, expected):
    plan = plan_of(1, 2, 3)
    assert plan.find_blocker([plan.slots[number] for number in silent], {*spoke}) \
        == tuple(expected)
    assert (plan.slots_size, plan.request.address) == (14, 132)


def test_plans_are_counted_and_forgotten_without_losing_counts():
    one = registry()
    planner = Planner(one, one._evidence)
    read = (INSTRUCTION_2, 3, int(I.READ), b'\x84\0\4\0')
    plan = planner.plan_for(read, S)
    assert planner.plan_for(read, S) is plan
    plan.asked += 5
    planner.updated_plans()
    assert (one.device(3).counts.reads, planner.instruction_count()) == (5, 5)
    planner.forget_plans()
    assert (one.device(3).counts.reads, planner.instruction_count(), planner.known) == (5, 5, {})
    again = planner.plan_for(read, S)
    again.asked += 2
    assert planner.instruction_count() == 7
    assert planner.has_answer(3, 4)
    assert not planner.has_answer(3, 3)
    assert not planner.has_answer(4, 4)


@pytest.mark.parametrize('impossible', [254, 255])
def test_an_adapter_is_asked_for_an_id_that_none_has(impossible):
    one = registry()
    planner = Planner(one, one._evidence)
    read = INSTRUCTION_1, 254, ADAPTER_READ, bytes((36, 0, 2, 0, 1, impossible))
    plan = planner.plan_for(read, S)
    assert [*plan.slots] == [1, 254]


def test_64_lists_of_sync_writes_are_kept():
    one = registry()
    planner = Planner(one, one._evidence)
    for number, kept in ((62, 63), (63, 64), (63, 64), (64, 1)):
        for other in range(63 if number == 62 else 0):
            planner._sync_write(b'\x74\0\1\0' + bytes([other, 7]), S)
        planner._sync_write(b'\x74\0\1\0' + bytes([number, 7]), S)
        assert len(planner._targets) == kept
    assert [one.devices[number].counts.writes for number in (61, 62, 63, 64)] == [1, 2, 2, 1]


@pytest.mark.parametrize(('data', 'detail'), [
    (b'\xff\xff\xfd', [ev.Code(3)]), (b'\xff\xff\xfd\xfd', []),
    (b'\xff\xff\xfd\xfd\xff\xff\xfd', [ev.Code(3)]), (b'\xff\xff\0\xfd', []),
])
@pytest.mark.parametrize('noise', [b'', b'\0\0'])
def test_what_a_master_did_not_stuff_is_noted(data, detail, noise):
    one = registry()
    tracker = Tracker(one, one._evidence, 4, 'auto')
    framer = Framer()
    wire = noise + encode(3, 3, b'\x74\0' + data, stuffed=False) + encode(3, STATUS, error=0)
    tracker.process_frames(framer.frames(wire), S, framer.bytes)
    plain = data.replace(b'\xfd\xfd', b'\xfd')
    assert one.device(3).table.bytes(116, len(plain)) == plain
    assert notes(one) == [(ev.UNSTUFFED, 3, code) for code in detail]


# --- dialects and unknown devices ---------------------------------------------------------------


def ping_1(number, noise=0):
    return 0, 6, EITHER_1, number, 1, b'', Flaw('', False, noise) if noise else None


def test_a_new_id_is_believed_alone_or_at_its_third_sighting_within_a_second_each():
    assert IdConfirmation(registry()).exists(ping_1(7), S, True)
    confirmation = IdConfirmation(registry())
    assert not confirmation.exists(ping_1(7), S, False)
    assert not confirmation.exists(ping_1(7), 2 * S, False)
    assert confirmation.exists(ping_1(7), 3 * S, False)
    confirmation = IdConfirmation(registry())
    for stamp in (S, 2 * S, 3 * S + 1, 4 * S + 1):
        assert not confirmation.exists(ping_1(7, 1), stamp, True)
    assert confirmation.exists(ping_1(7, 1), 5 * S + 1, True)
    known = registry()
    known.device(7)
    assert IdConfirmation(known).exists(ping_1(7), S, False)
