# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What people get wrong, and what breaks; with each what a person who sees all would call it.

right: names of which one is enough. fine: names that would also be true. A mistake is made in a
program that can show it: `needs` says what that is.
"""
from fuzz.programs.servos import ALL
from fuzz.programs.servos import MS
from fuzz.programs.servos import PING
from fuzz.programs.servos import READ
from fuzz.programs.servos import Servo
from fuzz.programs.servos import SYNC_WRITE

MISTAKES = {}
OWN = 'exact', 'head first', 'poll', 'bytewise'


def mistake(right, fine='', families='2 1 feetech'):
    """Keep a function that makes a mistake in a program; its name is the kind."""
    def keep(make):
        MISTAKES[make.__name__] = (make, set(right.split()), set(fine.split()), families.split())
        return make
    return keep


def _be_own(program):
    """Let the program have its own packet code, which people get wrong."""
    if program.reader == 'sdk':
        program.reader = program.chance.choice(OWN)


def _move(program, ask=None):
    """Let the program send goals, and watch where the joints go."""
    program.moves = program.torque = True
    program.asks = [('read', 'position'), (ask or program.chance.choice(('write', 'sync write')),
                                           'goal')]
    program.rests = False


def _see(program, *names):
    """Let the program read registers often enough."""
    program.asks += [('read', name) for name in names]


def _some(program):
    return program.bus.servos[program.chance.choice(program.numbers)]


def _later(program):
    return program.clock.now + program.chance.randint(1500, 3500) * MS


# --- nothing is wrong ----------------------------------------------------------------------------

@mistake('')
def nothing(program):
    pass


@mistake('')
def searches_first(program):
    program.raises, program.tries = False, 1
    size = 3 if program.is_2 else 0
    program.first.append(lambda: [program.exchange(one, PING, b'', size) for one in range(1, 20)])


@mistake('')
def torque_is_off_on_purpose(program):
    program.moves = program.torque = False
    program.asks = [ask for ask in program.asks if ask[1] != 'goal']
    for one in program.bus.servos.values():
        one.follows = False
    program.first.append(lambda: [program.write(one, 'torque', 0) for one in program.numbers])


@mistake('')
def holds_its_place(program):
    _move(program)
    place = program.model.full // 2
    program.goal_of = lambda turn, number: place
    for one in program.bus.servos.values():
        one.set('position', place + 3)
        one.follows = False


# --- packets and questions -----------------------------------------------------------------------

@mistake('wrong_packets', 'all_silent no_answer ping_only')
def wrong_checksum(program):
    _be_own(program)
    _see(program, 'temperature')
    code = program.chance.choice((READ, None))
    program.spelling = lambda packet, asked: packet[:-1] + bytes((packet[-1] ^ 0x5A,)) \
        if code in (asked, None) else packet


@mistake('wrong_packets', 'all_silent no_answer', '2')
def crc_bytes_swapped(program):
    _be_own(program)
    program.spelling = lambda packet, asked: packet[:-2] + packet[-1:] + packet[-2:-1]


@mistake('wrong_packets', 'torque_off no_answer all_silent')
def wrong_length_of_a_group_packet(program):
    _be_own(program)
    _move(program, 'sync write')
    at = 5 if program.is_2 else 3
    program.spelling = lambda packet, asked: packet if asked != SYNC_WRITE else \
        packet[:at] + bytes(((packet[at] + 1) % 250,)) + packet[at + 1:]


@mistake('no_answer', 'cycle_time')
def asks_a_servo_that_is_not_there(program):
    absent = next(one for one in range(20, 40) if one not in program.numbers)
    program.asks = [('read', 'position')]
    program.numbers.append(absent)
    program.pings = program.raises = False


@mistake('all_silent wrong_baud no_answer')
def wrong_baud_in_the_program(program):
    program.bus.baud_ok = False


@mistake('impossible_id')
def reads_from_all(program):
    _be_own(program)
    program.raises = False
    at, size = program.model.places['position']
    program.asks.append(('read next', 'position'))
    read = program.read
    program.read = lambda number, name: program.exchange(
        ALL, READ, program._place(at, size), size) if program.chance.random() < 0.3 \
        else read(number, name)


@mistake('sync_read_unsupported unknown_instruction', 'ping_only all_silent', '1')
def sync_read_to_servos_that_have_none(program):
    program.reader, program.raises = 'exact', False
    program.asks[0] = ('sync read', 'position')
    if program.chance.random() < 0.5:
        _see(program, 'temperature')


# --- reading -------------------------------------------------------------------------------------

@mistake('late_answers impatient_master unread_answers', 'missed_answers no_answer')
def time_out_shorter_than_the_adapter_holds(program):
    _be_own(program)
    program.timeout = program.port.timeout = 0.002
    program.wire.latency_ns = 16 * MS
    program.raises, program.tries = False, 1


@mistake('unread_answers impatient_master late_answers', 'missed_answers')
def reads_before_the_answer_is_there(program):
    _be_own(program)
    program.read_after = 0.0003
    program.wire.latency_ns = 6 * MS
    program.raises, program.tries = False, 1


@mistake('unread_answers', 'impatient_master')
def reads_too_few_bytes_and_never_clears(program):
    program.reader, program.clears, program.read_more = 'exact', False, -2
    program.raises, program.tries = False, 1
    program.asks = [('read', 'position')]


@mistake('cycle_time', '')
def reads_more_bytes_than_come(program):
    program.reader, program.read_more, program.raises, program.tries = 'exact', 4, False, 1
    program.asks = [('read', 'position')]


@mistake('impatient_master unread_answers two_masters', 'noise damaged_answers turnaround '
         'missed_answers late_answers')
def writes_and_asks_into_the_acknowledgement(program):
    _be_own(program)
    _move(program, 'write')
    program.asks.reverse()
    program.waits_for_acks = program.raises = False


# --- goals ---------------------------------------------------------------------------------------

@mistake('torque_off')
def forgets_the_torque(program):
    _move(program)
    program.torque = False


@mistake('goal_limits', 'torque_off refused')
def goals_beyond_the_limit(program):
    _move(program)
    program.reads_limits, program.raises = True, False
    full = program.model.full
    program.goal_of = lambda turn, place: full + 200 + 40 * (turn // 10 % 3)


@mistake('goal_limits wheel_stopped', '', '2')
def velocity_beyond_the_limit(program):
    _move(program, 'sync write')
    program.asks = [('read', 'velocity'), ('sync write', 'goal_velocity')]
    for one in program.bus.servos.values():
        one.set('mode', 1)
    program.first.append(lambda: [program.read(one, name) for one in program.numbers
                                  for name in ('mode', 'velocity_limit', 'torque')])
    program.goal_of = lambda turn, place: 300


@mistake('eeprom_wear', 'eeprom_locked lock')
def writes_eeprom_in_each_cycle(program):
    program.torque = program.moves = program.raises = False
    program.asks = [('read', 'position'), ('write', 'max_temperature')]
    program.goal_of = lambda turn, place: 70
    program.period = max(program.period, 0.02)


@mistake('eeprom_locked', '', '2')
def writes_eeprom_under_torque(program):
    program.raises = False
    program.first.append(lambda: [program.write(one, 'torque', 1) for one in program.numbers])
    program.first += [lambda: [program.write(one, 'max_temperature', 70)
                               for one in program.numbers]] * 4


# --- servos, cables, supply ----------------------------------------------------------------------

@mistake('no_answer sync_read_stops all_silent', 'cycle_time')       # all wait behind the first
def a_servo_dies(program):
    if len(program.numbers) == 1:              # one alone is as a supply that is off
        program.numbers.append(21)
        program.bus.servos[21] = Servo(21, program.model, program.chance)
    _some(program).silent = _later(program)


@mistake('all_silent no_answer')
def the_supply_is_off(program):
    since = program.clock.now if program.chance.random() < 0.5 else _later(program)
    for one in program.bus.servos.values():
        one.silent = since


@mistake('missed_answers dropout', 'torque_off')
def a_loose_plug(program):
    servo = _some(program)
    servo.loses = program.chance.uniform(0.08, 0.25)
    program.raises = False
    if program.is_2:
        program.asks[0] = ('read', 'position')


@mistake('damaged_answers', 'noise missed_answers')
def one_bad_cable(program):
    head = {one: (bytes((0xFF, 0xFF, 0xFD, 0, one)) if program.is_2 else bytes((0xFF, 0xFF, one)))
            for one in program.numbers}
    bad = head[_some(program).number]
    program.wire.damage = lambda data: _flipped(program, data, 0.3) \
        if data.startswith(bad) else data
    program.raises = False


@mistake('noise', 'damaged_answers missed_answers duplicate_id')
def interference(program):
    program.wire.damage = lambda data: _flipped(program, data, 0.12)
    program.raises = False


def _flipped(program, data, share):
    if program.chance.random() > share:
        return data
    place = program.chance.randrange(len(data))
    return data[:place] + bytes((data[place] ^ 1 << program.chance.randrange(8),)) \
        + data[place + 1:]


@mistake('duplicate_id', 'damaged_answers noise')
def two_servos_of_one_id(program):
    _some(program).twin = program.chance.choice((20_000, 60_000, 900_000))
    program.asks = [('read', 'position')]
    program.raises = False


@mistake('too_hot')
def a_servo_is_too_hot(program):
    _see(program, 'temperature')
    program.reads_limits = True
    program.first.append(lambda: [program.read(one, 'model') for one in program.numbers])
    servo = _some(program)
    servo.set('temperature', servo.get('max_temperature') + 1)


@mistake('hardware_error')
def an_overloaded_servo(program):
    servo = _some(program)
    servo.alert = 0x80 if program.is_2 else 0x20
    if program.is_2:
        servo.set('error', 0x20)
        _see(program, 'error')


@mistake('brown_out rebooted', 'torque_off dropout')
def the_supply_fails_for_a_moment(program):
    _move(program)
    program.raises = False
    program.bus.restarts = _later(program)


@mistake('torque_off')
def a_joint_is_blocked(program):
    _move(program)
    _some(program).follows = False


@mistake('echo')
def an_adapter_that_echoes(program):
    program.wire.echo = True


@mistake('text')
def a_board_that_answers_by_itself(program):
    program.bus.text = program.chance.choice((
        b'Unknown command\r\n', b'{"T":1051,"x":0}\r\n', b'rst:0x1 (POWERON_RESET),boot:0x13\r\n'))


@mistake('late_answers unread_answers', 'missed_answers')
def a_slow_servo(program):
    servo = _some(program)
    servo.delay_ns = int((program.timeout + 0.004) * 1e9)
    program.asks = [('read', 'position')]
    program.raises = program.moves = False
    _be_own(program)
    program.tries = 1


@mistake('ping_only no_answer')
def a_servo_that_answers_pings_only(program):
    servo = _some(program)
    servo.answers_reads = False
    program.pings, program.raises = True, False
    program.asks = [('read', 'position')]


@mistake('group_read_unanswered sync_read_stops sync_read_unsupported', 'no_answer', '2 feetech')
def a_servo_without_group_reads(program):
    servo = _some(program)
    servo.group_reads = False
    program.asks = [('sync read', 'position'), ('read', 'temperature')]
    program.raises, program.tries = False, 1
