# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The flight recorder: what was before a fault and after it, one file for each."""
import os
from types import SimpleNamespace

from harness import wait
import pytest

from msg_defs.diagnostics import Level
from msg_defs.event import Change
from msg_defs.event import Chunk
from servobus.bus.decoder import Settings
from servobus.bus.report import DISCONNECTED
from servobus.errors import ParameterError
from servobus.examination import Examination
from servobus.model.models import Models
from servobus.monitored_bus import MonitoredBus
from servobus.settings import Bus
from servobus.sources.capture import ClockReading
from servobus.sources.capture import Reader
from servobus.sources.capture import Wire
from servobus.sources.flight_recorder import FlightRecorder
from servobus.sources.opening import open_file
from servobus.sources.recorders import Recorders
from servobus.tools.doctor.error_window import ErrorWindow

S = 1_000_000_000


WIRE = Wire('arm', 1_000_000, port='/dev/ttyUSB0')
WELL = SimpleNamespace(findings=(), devices=())


def finding(rule='no_answer', device=7, level=Level.WARN):
    one = SimpleNamespace(rule=rule, device=device, level=level, message='check its power')
    return SimpleNamespace(findings=(one,), devices=())


class Flight:
    """A recorder on a clock of its own, and a bus with a chunk in each tenth of a second."""

    def __init__(self, folder, size=1_000_000_000):
        self.folder = folder
        self.now = 1000 * S
        self.recorder = FlightRecorder(str(folder), size, 1, self.clock)

    def clock(self):
        return ClockReading(1_790_000_000 * S + self.now, self.now)

    def run(self, seconds, report=WELL):
        for _ in range(round(10 * seconds)):
            self.now += S // 10
            self.recorder.record_chunk(
                WIRE, Chunk(self.now, WIRE.name, self.now.to_bytes(8, 'little')))
            self.recorder.record_report('arm', report)

    def files(self):
        return sorted(self.folder.glob('*.txt'))


def stamps(path):
    """Return the times of the chunks of a file, in s."""
    chunks = [one for one in open_file(str(path), None, tool='dxl_dump').chunks() if one.data]
    assert all(int.from_bytes(one.data, 'little') == one.stamp for one in chunks)
    return [one.stamp / S for one in chunks]


def learned(now):
    """Return chunks of a bus of which the rate is learned, two minutes before the last."""
    return [Chunk(now, 'arm', change=Change('baud', 57_600)),
            Chunk(now, 'arm', change=Change('latency_timer_ms', 16)),
            Chunk(now + 1, 'arm', b'\xff', 'out'), Chunk(now + 120 * S, 'arm', b'\xff', 'out')]


def test_a_file_has_the_rate_that_was_learned_before_its_time(tmp_path):
    flight = Flight(tmp_path)
    node = MonitoredBus(Bus('arm', '', 'tap:arm', Settings(0)), Models(),
                        Recorders(None, flight.recorder))
    node._record_and_feed(learned(flight.now))
    path = flight.recorder.save('asked')
    flight.recorder.stop()
    source = open_file(path, None, tool='dxl_dump')
    assert [one.stamp - flight.now for one in source.chunks()] == [120 * S]
    assert source.wire('arm') == Wire('arm', 57_600, 16, 'tap:arm')


def test_a_report_has_the_rate_that_was_learned_before_its_time():
    window = ErrorWindow()
    examination = Examination(Models(), watchers=[window])
    for chunk in learned(S):
        examination.feed_chunk(chunk, Wire('arm', 0))
    reader = Reader(window.capture({'arm': 'bus1'}).splitlines(keepends=True))
    assert [one.stamp for one in reader] == [121 * S]
    assert reader.wires == {'bus1': Wire('bus1', 57_600, 16)}


@pytest.fixture
def flight(tmp_path):
    flight = Flight(tmp_path / 'faults')
    yield flight
    flight.recorder.stop()


def test_a_finding_is_in_a_file_with_a_minute_before_and_half_a_minute_after(flight):
    flight.run(100)
    begin = flight.now / S
    flight.run(50, finding())
    [path] = flight.files()
    assert path.name.endswith('_arm_no_answer_007.txt')
    found = stamps(path)
    assert found[0] == pytest.approx(begin - 59.9) and found[-1] == pytest.approx(begin + 30.2)
    assert len(found) == round(10 * (found[-1] - found[0])) + 1            # none left out
    text = path.read_text()
    assert '# flight recorder: recording of arm_no_answer_007, with the 60.0 s before it\n' in text
    assert 'finding at 1100.100000000: arm 007 no_answer: WARN check its power\n' in text


def test_it_says_how_far_it_reaches_and_a_later_finding_is_in_the_same_file(flight):
    flight.run(5)
    flight.run(10, finding())
    flight.run(30, finding('noise', None, Level.ERROR))
    [path] = flight.files()
    text = path.read_text()
    assert 'with the 5.0 s before it' in text
    assert 'arm bus noise: ERROR check its power' in text


def test_a_finding_that_comes_and_goes_makes_a_file_in_ten_minutes(flight):
    for _ in range(30):                          # 20 minutes
        flight.run(20)
        flight.run(20, finding())
    assert len(flight.files()) == 2


def test_a_lost_device_is_recorded_and_advice_is_not(flight):
    flight.run(5, finding(level=Level.OK))
    assert not flight.files()
    lost = SimpleNamespace(id=3, state=DISCONNECTED, level=Level.ERROR, message='lost')
    flight.run(1, SimpleNamespace(findings=(), devices=(lost,)))
    [path] = flight.files()
    assert path.name.endswith('_arm_lost_003.txt')


def test_it_is_written_when_asked_and_events_are_in_it(flight):
    flight.recorder.record_chunk(WIRE, Chunk(flight.now, WIRE.name, change=Change('unplugged', 1)))
    path = flight.recorder.save('asked')
    assert flight.recorder.save('asked') == path
    flight.recorder.stop()
    [chunk] = open_file(path, None, tool='dxl_dump').chunks()
    assert chunk.change == Change('unplugged', 1)
    assert flight.recorder.words == f'flight recorder: wrote {path}'


def test_without_it_that_is_said():
    assert Recorders(None, None).save() == (
        False, 'the flight recorder is off; set flight_recorder to a folder')


def test_the_oldest_files_go_and_no_other_file(tmp_path):
    flight = Flight(tmp_path, 70_000)
    (tmp_path / 'notes.txt').write_text('mine')
    for number in range(5):
        flight.run(40, finding(device=number))
    flight.recorder.stop()
    names = [path.name for path in flight.files()]
    assert 'notes.txt' in names
    assert [name[-7:-4] for name in names[:-1]] == ['002', '003', '004']


def test_memory_is_bounded(flight):
    for _ in range(400):
        flight.now += S // 10
        flight.recorder.record_chunk(WIRE, Chunk(flight.now, WIRE.name, bytes(1_000_000)))
    assert flight.recorder._kept <= 32_000_000


def test_a_folder_that_cannot_be_used_is_refused(tmp_path):
    (tmp_path / 'file').write_text('')
    with pytest.raises(ParameterError, match=r'flight_recorder: .*file/x: Not a directory'):
        FlightRecorder(str(tmp_path / 'file' / 'x'), 1, 1)


def test_links_in_the_folder_are_left_alone(tmp_path):
    """A link to the newest file points to nothing when that is deleted."""
    folder = tmp_path / 'faults'
    flight = Flight(folder, size=1)
    nowhere, newest = folder / 'flight_0.txt', folder / 'flight_newest.txt'
    nowhere.symlink_to(tmp_path / 'gone')
    (folder / 'flight_folder.txt').mkdir()
    for device in range(3):
        flight.run(40, finding(device=device))
        flight.run(1)
        newest.unlink(missing_ok=True)
        newest.symlink_to(flight.recorder.path)
        assert newest.exists()
        assert not flight.recorder.problem
    assert nowhere.is_symlink()
    assert [one.name for one in flight.files() if one.is_file() and not one.is_symlink()] == [
        newest.readlink().name]
    flight.recorder.stop()


@pytest.mark.skipif(not os.path.exists('/dev/full'), reason='skipped: no /dev/full')
def test_a_full_disk_is_said_and_the_next_fault_is_tried_again(flight, monkeypatch):
    monkeypatch.setattr('servobus.sources.capture_recorder.open_new',
                        lambda path, waits: open('/dev/full', 'wb'))     # noqa: SIM115
    flight.run(1)
    flight.run(1, finding())
    wait(lambda: flight.run(0.1, finding()) or flight.recorder.problem)
    assert 'No space left on device' in flight.recorder.problem
    flight.run(31)
    monkeypatch.undo()
    flight.run(1, finding(device=8))
    assert not flight.recorder.problem and len(flight.files()) == 1
