# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The same scenes in real time: played into a pty, heard by the product's own listener.

    python -m rigs.bus_live              a sample of 20
    python -m rigs.bus_live NAME...      those whose name has one of these words

What is on the wire is worked out before, so that only the delivery is real. A run in which the
player itself was late does not count, and its row says so.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
import sys
from threading import Thread
import time

from dxl_monitor.bus.decoder import Settings
from dxl_monitor.bus.expected import parse_all
from dxl_monitor.bus.report import BusReport
from dxl_monitor.model.models import Models
from dxl_monitor.monitor import Monitor
from dxl_monitor.port.listener import Listener
from dxl_monitor.record.capture import Chunk
from dxl_monitor.tools.replay import Played
from dxl_monitor.tools.replay import Player
from mecarover_serial.pty import Pty
from rigs.bus.rig import Rig
from rigs.bus.scene import Scene
from rigs.bus.scene import SECONDS
from rigs.bus.score import cells
from rigs.bus.score import compare
from rigs.bus.score import REPORT_NS
from rigs.bus.score import Result
from rigs.bus.score import SCENES
from rigs.bus.score import SEED
from rigs.bus.wire import S

SAMPLE = 20
LATE_S = 0.010                     # what is later is another bus than the one that was meant
BUS = 'bus'


def play(scene: Scene, models: Models) -> tuple[Result, float]:
    """Run a scene in real time; return what was said of it, and how late the player was (s)."""
    rig = scene.rig(SEED)
    chunks: list[Chunk] = []
    rig.listen(scene.ear, lambda data, stamp: chunks.append(Chunk(stamp, BUS, data)),
               lambda now: None)
    rig.clock.run(round(SECONDS * S))
    monitor = Monitor(BUS, models, Settings(baud=scene.ear.baud or scene.baud, devices=tuple(
        parse_all(list(scene.devices)))), idle_is_told=True)
    outlet = Pty()
    outlet.let_go()
    listener = Listener(outlet.path, scene.ear.baud or scene.baud, monitor.feed,
                        monitor.flush_if_idle)
    player = Player({BUS: outlet}, 1.0)
    listener.start()
    try:
        player.wait_for_readers()
        played: list[Played] = []
        begin = time.monotonic_ns() - chunks[0].stamp      # as the scene counts
        thread = Thread(target=lambda: played.append(player.play(iter(chunks))))
        thread.start()
        result = compare(scene, rig, _reports(monitor, rig, begin), begin)
        thread.join()
    finally:
        listener.stop()
        outlet.close()
    return result, played[0].late_s


def _reports(monitor: Monitor, rig: Rig, begin: int) -> Iterator[tuple[BusReport, float | None]]:
    """Yield the reports, two per second, each with the seconds since the fault showed."""
    for number in range(1, round(SECONDS * S) // REPORT_NS + 1):
        due = begin + number * REPORT_NS
        time.sleep(max(0, due - time.monotonic_ns()) / S)
        now = time.monotonic_ns()
        shown = rig.altered is not None and now - begin >= rig.altered
        yield monitor.report(now), (now - begin - rig.altered) / S \
            if rig.altered is not None and shown else None


def main(names: list[str]) -> int:
    """Play, and print a row for each scene and the score of those that count."""
    chosen = [scene for scene in SCENES if any(name in scene.name for name in names)]
    if not names:
        chosen = list(SCENES[::len(SCENES) // SAMPLE][:SAMPLE])
    models = Models()
    counted: Counter[str] = Counter()
    for scene in chosen:
        result, late_s = play(scene, models)
        is_late = late_s > LATE_S
        print(' | '.join((scene.name, *cells(result))) + (
            f' does not count: the player was {1000 * late_s:.0f} ms late'
            if is_late else ''), flush=True)
        counted.update(() if is_late else (result.verdict,))
    print(f'{len(chosen) - counted.total()} of {len(chosen)} runs do not count; '
          + ', '.join(f'{number} {verdict}' for verdict, number in counted.items()))
    return 0


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
