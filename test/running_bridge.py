# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The bridge as a process, and an MCU that remembers."""
from itertools import dropwhile

from harness import Program
from harness import wait

from rigs.running_mcu import RunningMcu


def bridge(mcu, *ros_arguments, script=None, prefix=(), **parameters):
    """Start vel2d_bridge on a fake MCU, or on the path of a port."""
    given = {'port': getattr(mcu, 'path', mcu), **parameters}
    options = [part for name, value in given.items() for part in ('-p', f'{name}:={value}')]
    return Program('vel2d_bridge.main', '--ros-args', *options, *ros_arguments,
                   script=script, prefix=prefix)


class Mcu(RunningMcu):
    """A fake MCU as tests ask it; frames are in `arrivals`."""

    @property
    def arrivals(self):
        return list(self.receiver.arrivals)

    @property
    def velocity(self):
        """The velocity of the newest frame, None before the first."""
        arrivals = self.receiver.arrivals
        return arrivals[-1].velocity if arrivals else None

    def since(self, stamp, count=0):
        """Wait for `count` frames that come at `stamp` or later; return these."""
        def found():
            return [arrival for arrival in self.arrivals if arrival.stamp >= stamp]
        wait(lambda: len(found()) >= count)
        return found()

    def stopped_at(self, stamp):
        """Wait until the wheels hold zero; return when they began to, ns after `stamp`."""
        # Of what is kept, not of the wheels: these turn a moment before it is.
        wait(lambda: self.set_points and self.set_points[-1].stamp > stamp
             and self.set_points[-1].is_stop)
        moving = [point.stamp for point in self.set_points
                  if point.stamp > stamp and not point.is_stop]
        return next(point.stamp for point in self.set_points
                    if point.stamp > max(moving, default=stamp)) - stamp

    def wait_drive(self, stamp, x):
        """
        Wait until the wheels turn with `x` mm/s since a port was opened after `stamp`.

        An opening begins with stops. What turns before them was sent earlier: wheels go on
        turning while a cable is out, and by what a bridge has left in the line.
        """
        def drives():
            since = list(dropwhile(lambda point: point.stamp <= stamp or not point.is_stop,
                                   list(self.set_points)))
            return bool(since) and since[-1].x == x
        wait(drives)
