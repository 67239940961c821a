# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What holds in every row of the bridge's fault table, and what a row can ask of it.

A command carries in omega when it was published (monotonic s), and in x the row that it belongs
to. So each frame at the MCU tells whether somebody commanded it, and how old it is.
"""
from contextlib import contextmanager
from itertools import count
from itertools import pairwise
import re
import time

from harness import Background
from harness import LATE_S
from harness import wait

from msg_defs.vel2d import decode
from msg_defs.vel2d import FRAME_SIZE
from msg_defs.vel2d import STOP
from vel2d_bridge.gate import BURST_FRAMES

LINK, COMMANDS = 'link', 'commands'
CMD_VEL_TIMEOUT_S = 0.5                     # the default
BOUND_S = CMD_VEL_TIMEOUT_S + 2 / 20 + 0.05 + 0.3      # resends, write_timeout, queue
RATE = 50                                   # commands per s
SLACK = 2                                   # times as late as this process may the others be
LATE_ENOUGH_S = 0.15                        # for the bridge to look frozen, if it is the same
COUNTERS = re.compile(r'Frames sent|Openings|Reopenings|Losses|Write time-outs|Partial writes|'
                      r'Freezes|Bytes|Lines|Garbage|Commands |Zero stamps|Refused: |Time-outs|'
                      r'Stops: ')


class Lateness(Background):
    """How late (s) a thread of this process wakes up at most: what the machine adds to a bound."""

    def __init__(self):
        super().__init__()
        self.longest_s = 0.0

    def _run(self):
        before = time.monotonic()
        while not self._done.wait(0.01):
            now = time.monotonic()
            self.longest_s = max(self.longest_s, now - before - 0.01)
            before = now


class Rover:
    """A bridge, its operator in the ROS graph and its fake MCU, perhaps with a cable between."""

    def __init__(self, graph, ros, mcu, running, cable=None, node='vel2d_bridge', namespace=''):
        self.graph, self.ros, self.mcu, self.running = graph, ros, mcu, running
        self.cable = cable
        self.status_node = f'{namespace}/{node}'.lstrip('/')
        self.topic = f'{namespace}/cmd_vel'
        self.timing = f'{namespace}/vel2d/timing'
        self.graph.listen(ros.DiagnosticArray, self.timing)
        self.publisher = None
        self.publish()
        self._speeds = count(200)
        self._first = len(graph.heard['/diagnostics'])      # an earlier one had the same name

    def publish(self, kind=None):
        """Be the one who publishes commands, of the given type."""
        self.leave()
        self.publisher = self.graph.publisher(self.topic, kind or self.ros.Twist)

    def leave(self):
        """Publish no commands: somebody else does."""
        if self.publisher is not None:
            self.graph.node.destroy_publisher(self.publisher)
        self.publisher = None

    def heard(self, kind, begin=0):
        """Return what was heard of a status, its values as a dict, the newest last."""
        name = f'{self.status_node}: {kind}'
        messages = self.graph.heard['/diagnostics'][max(begin, self._first):]
        return [Heard(status) for message in messages for status in message.status
                if status.name == name]

    def is_well(self):
        return all(self.heard(kind)[-1].level == 0 for kind in (LINK, COMMANDS))

    @contextmanager
    def row(self):
        """Begin a row when the rover stands; at its end all holds that must hold in each row."""
        with Lateness() as lateness:
            row = Row(self, next(self._speeds) / 1000, lateness)
            try:
                yield row
                row.check()
            finally:
                row.halt()


class Heard:
    """A status."""

    def __init__(self, status):
        self.level = status.level[0]
        self.values = {pair.key: pair.value for pair in status.values}
        self.text = '\n'.join([status.message, *(f'{key}={value}'
                                                 for key, value in self.values.items())])
        self.complaints = [value for key, value in self.values.items()
                           if key.startswith('Complaint')]

    def counters(self):
        return {key: int(value) for key, value in self.values.items() if COUNTERS.match(key)}


class Row:
    """
    One fault: commands of one speed, and what came of them.

    `last` is when the last command was published (monotonic ns), `delay_s` what the cable adds.
    """

    def __init__(self, rover, speed, lateness):
        self.rover, self.mcu, self.speed = rover, rover.mcu, speed
        self.delay_s = 0.0
        self.last = 0
        self._lateness = lateness
        self._teleop = None
        self._is_quiet = False
        self._may_be_seen = ()
        wait(lambda: rover.heard(LINK) and rover.heard(COMMANDS))
        self._first = len(rover.graph.heard['/diagnostics'])
        self._before = {kind: rover.heard(kind)[-1] for kind in (LINK, COMMANDS)}
        self._begin = time.monotonic_ns()
        self._said = len(rover.running.lines)
        self._line = len(rover.cable.lines) - 1 if rover.cable else 0

    # --- commands ----------------------------------------------------------------------------

    def command(self):
        """Return a command as it is published now."""
        ros = self.rover.ros
        make = ros.stamped if self.rover.publisher.msg_type is ros.TwistStamped else ros.twist
        return make(self.speed, 0.0, time.monotonic())

    def drive(self, message=None):
        """Publish commands from now on; without a message of its own, until the rover moves."""
        self.halt()
        self._teleop = self.rover.ros.Teleop(
            self.rover.publisher, message or self.command, rate=RATE)
        self._teleop.__enter__()
        if message is None:
            wait(self.moves)

    def halt(self):
        """Publish none any more."""
        if self._teleop is not None:
            self._teleop.stop()
            self.last = self._teleop.last
        self._teleop = None

    # --- the MCU -----------------------------------------------------------------------------

    def moves(self):
        return self.mcu.receiver.wheels.x == self.speed * 1000

    def frames(self, begin=None):
        """Return the good frames since then."""
        begin = self._begin if begin is None else begin
        return [one for one in self.mcu.arrivals
                if one.stamp >= begin and one.velocity is not None]

    def drives(self, begin=None):
        """Return the good frames that drive with a command from `begin` on."""
        begin = self._begin if begin is None else begin
        return [one for one in self.frames(begin)
                if one.velocity != STOP and one.velocity.omega * 1e9 >= begin]

    def until_driving(self, begin):
        """Return how long after `begin` a good frame with a command from after it came (s)."""
        return max(0.0, wait(lambda: self.drives(begin))[0].stamp - begin) / 1e9

    def longest_gap(self, begin):
        """Return the longest time (s) between driving frames since `begin`."""
        stamps = [one.stamp for one in self.drives(begin)]
        return max(b - a for a, b in pairwise([begin, *stamps])) / 1e9

    def drove_on(self, begin):
        """Tell whether the bridge sent no stop since `begin`; it may if it was frozen."""
        return all(one.velocity != STOP for one in self.frames(begin)) or self.was_disturbed()

    def late_s(self):
        """Return by how much anything may exceed its bound on this machine."""
        return LATE_S + self.measured_late_s() + self.delay_s

    def measured_late_s(self):
        return SLACK * self._lateness.longest_s

    def stops_in_time(self):
        """End the commands; the rover stops within the bound. Return after how long (s)."""
        self.halt()
        stopped_s = self.mcu.stopped_at(self.last) / 1e9
        assert stopped_s < BOUND_S + self.late_s()
        return stopped_s

    # --- what the user sees ------------------------------------------------------------------

    def quiet(self, *but):
        """Begin with all well; in this row the user is to see nothing of the fault, `but`..."""
        wait(self.rover.is_well)
        self.forget()
        self._is_quiet = True
        self._may_be_seen = but

    def forget(self):
        """Begin again: what was heard until now is not what the user sees of the fault."""
        self._first = len(self.rover.graph.heard['/diagnostics'])

    def end_of_quiet(self):
        """Let be seen what comes now; what came before was not, but for a freeze."""
        seen = [one.text for kind in (LINK, COMMANDS) for one in self.heard(kind)
                if one.level and not all(any(part in complaint for part in self._may_be_seen)
                                         for complaint in one.complaints or [one.text])]
        assert not seen or self.was_disturbed(), seen
        self._is_quiet = False

    def was_disturbed(self):
        """Tell whether the machine, not the fault, has stopped the rover for a moment."""
        if not self._is_disturbed():            # a report may be on its way that says so
            heard = len(self.heard(LINK))
            wait(lambda: len(self.heard(LINK)) > heard + 1)
        return self._is_disturbed()

    def _is_disturbed(self):
        return (self._lateness.longest_s > LATE_ENOUGH_S or self.grown(LINK, 'Freezes')
                or self.grown(COMMANDS, 'Refused: bridge was frozen'))

    def heard(self, kind):
        return self.rover.heard(kind, self._first)

    def sees(self, kind, *parts, level):
        """Wait for a status of this row with that level and all `parts` in its text."""
        def found():
            return [one for one in self.heard(kind)
                    if one.level == level and all(part in one.text for part in parts)]
        try:
            return wait(found)
        except AssertionError:
            raise AssertionError(f'{kind}, level {level}, {parts}: not in ' + '\n---\n'.join(
                one.text for one in self.heard(kind)[-3:])) from None

    def grown(self, kind, key):
        """Return how much a counter has grown in this row."""
        newest = (self.heard(kind) or [self._before[kind]])[-1]
        return int(newest.values[key]) - int(self._before[kind].values[key])

    def counts(self, kind, key, at_least=1):
        """Wait until a counter has grown."""
        wait(lambda: self.grown(kind, key) >= at_least)

    def said(self, *parts):
        """Return the lines of this row's log that hold all of `parts`."""
        return [line for line in self.rover.running.lines[self._said:]
                if all(part in line for part in parts)]

    def says(self, *parts):
        wait(lambda: self.said(*parts))

    # --- at its end --------------------------------------------------------------------------

    def check(self):
        """End the row: what must hold in each of them."""
        self._goes_on()
        self.stops_in_time()
        self._nobody_else_commanded()
        self._new_lines_begin_with_a_stop()
        for kind in (LINK, COMMANDS):
            self._counts_go_up(kind)
        if self._is_quiet:
            self.end_of_quiet()

    def _goes_on(self):
        """Wait for reports and statistics that say that all is well, and for counters."""
        self.halt()
        graph = self.rover.graph
        statuses, timings = (len(graph.heard[topic])
                             for topic in ('/diagnostics', self.rover.timing))
        wait(lambda: len(graph.heard['/diagnostics']) > statuses
             and len(graph.heard[self.rover.timing]) > timings)
        assert self.grown(LINK, 'Frames sent') > 0
        wait(self._is_well)

    def _is_well(self):
        """Tell whether the port is open and no complaint but of what was refused just now."""
        link, commands = (self.rover.heard(kind)[-1] for kind in (LINK, COMMANDS))
        openings = len(self.rover.running.said('open at 115200 baud'))
        return (link.level == 0 and link.values['State'] == 'open'
                and int(link.values['Openings']) == openings
                and int(link.values['Losses']) == openings - 1
                and all('commands are refused' in one for one in commands.complaints))

    def _nobody_else_commanded(self):
        """Each frame is a stop or a command of this row, and none is older than the time-out."""
        begin, now = self._begin / 1e9, time.monotonic()
        for one in self.frames():
            x, y, omega = one.velocity
            assert one.velocity == STOP or (x == self.speed and y == 0
                                            and begin <= omega <= now), one
            assert one.velocity == STOP or one.stamp / 1e9 - omega < BOUND_S + self.late_s()

    def _new_lines_begin_with_a_stop(self):
        """And what drives then was commanded after the line before had ended."""
        for line in self.rover.cable.lines[self._line:] if self.rover.cable else ():
            whole = len(line.written) // FRAME_SIZE
            velocities = [decode(bytes(line.written[at * FRAME_SIZE:][:FRAME_SIZE]))
                          for at in range(whole)]
            assert velocities[:1] in ([], [STOP]), velocities[:3]
            first = next((one for one in velocities if one not in (STOP, None)), None)
            assert first is None or first.omega + self.measured_late_s() > line.until / 1e9, first

    def _counts_go_up(self, kind):
        """No counter is lost, and each command is accepted or refused for a reason."""
        heard = [self._before[kind], *self.heard(kind)]
        for before, after in pairwise(one.counters() for one in heard):
            assert before.keys() == after.keys()
            assert all(before[key] <= after[key] for key in before), (before, after)
        for one in (one.counters() for one in heard if kind == COMMANDS):
            assert one['Commands received'] == one['Commands accepted'] + sum(
                value for key, value in one.items() if key.startswith('Refused: '))


def burst(row, begin):
    """Wait for a whole burst of stops since `begin`."""
    wait(lambda: sum(one.velocity == STOP for one in row.frames(begin)) >= BURST_FRAMES)
