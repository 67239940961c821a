# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""CONTRIBUTING.md, "How to add": one of each kind is added by its steps in a copy of the code."""

import os
from pathlib import Path
import re
import subprocess
import sys

import pytest
from test_packaging import copy_tree

ROOT = Path(__file__).parents[1]


GRIPPER = """model_numbers: {4660: Gripper}
source: firmware/registers.h
fields:
  - {at: 0, name: Model Number, type: u16, access: r, memory: eeprom}
  - {at: 24, name: Present Position, type: i16, access: r, memory: ram, unit: m, scale: 0.001}
"""


def section(kind):
    """Return what CONTRIBUTING.md says about adding one of this kind."""
    text = (ROOT / 'CONTRIBUTING.md').read_text()
    [found] = re.findall(rf'### {re.escape(kind)}[^\n]*\n(.*?)(?=\n##)', text, re.DOTALL)
    return str(found)


class Copy:
    """A copy of the code. change() takes a file that the section names, no other."""

    def __init__(self, folder, kind):
        self.folder = folder
        self.section = section(kind)
        copy_tree(folder, '*.png', 'corpus')

    def change(self, path, *edits, named=''):
        """Put text in front of an anchor that stands in the file once; a file may be new."""
        assert f'`{named or path}`' in self.section, path
        file = self.folder / path
        if not file.exists():
            file.write_text(edits[0][1])
            return
        text = file.read_text()
        for anchor, insertion in edits:
            assert text.count(anchor) == 1, (path, anchor)
            text = text.replace(anchor, insertion + anchor)
        file.write_text(text)

    def run(self, *arguments):
        """Run Python in the copy; return what it prints."""
        done = subprocess.run([sys.executable, *arguments], cwd=self.folder, text=True,
                              capture_output=True, check=False, timeout=60,
                              env={**os.environ, 'PYTHONPATH': str(self.folder / 'test')})
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout.strip()

    def passes(self, file, tests, least=1):
        """Run those tests of a file in the copy that have such a name."""
        said = self.run('-m', 'pytest', '-q', '-p', 'no:cacheprovider', f'test/{file}',
                        '-k', tests)
        found = re.search(r'(\d+) passed', said)
        assert found is not None and int(found[1]) >= least, said


@pytest.fixture
def copy(tmp_path):
    return lambda kind: Copy(tmp_path, kind)


def test_a_model(copy):
    code = copy('a model')
    code.change('servobus/model/files/gripper.yaml', ('', GRIPPER),
                named='servobus/model/files/NAME.yaml')
    assert code.run('-c', """
from servobus.model.models import Models
model = Models().get(4660)
print(model.name, [field.name for field in model.fields])
""") == "Gripper ['Model Number', 'Present Position']"


@pytest.mark.more
def test_an_instruction(copy):
    code = copy('an instruction')
    code.change('msg_defs/dxl_instruction.py',
                ('    STATUS = 0x55\n', '    HOME = 0x21\n'),
                ('    Instruction.SYNC_READ: Kind', '    Instruction.HOME: Kind(Answers.ACK),\n'))
    code.change('servobus/bus/registry.py', ('    def reboot(', """\
    def home(self, device: Device, stamp: int) -> None:
        self.resolve(device)
        device.table.forget('ram', device.model)

"""))
    code.change('servobus/bus/instruction_plans.py', (
        '            Instruction.REBOOT: ', '            Instruction.HOME: registry.home,\n'))
    code.change('mecarover_fakes/fake_servo.py',
                ('    def _on_reboot(', """\
    def _on_home(self, params: bytes, now: int) -> Reply:
        self.rest_angle = 0.0
        return Reply(OK)

"""),
                ('    Instruction.REBOOT: ', '    Instruction.HOME: FakeDevice._on_home,\n'))
    code.change('test/whole_truth.py', (
        '    Instruction.REBOOT: ', '    Instruction.HOME: WholeTruth._learn_restart,\n'))
    code.change('test/fuzz/instruction.py', ('OPTIONS = {', 'ACKNOWLEDGED += (0x21,)\n'))
    code.change('msg_defs/dxl1_instruction.py', (
        '             Instruction.BULK_READ: ',
        '             Instruction.HOME: DialectInstruction(_nothing, Answers.ACK),\n'))
    assert code.run('-c', """
from servobus.bus.decoder import BusDecoder
from mecarover_fakes.fake_servo import FakeDevice
from servobus.model.models import Models
from msg_defs.dxl_instruction import name_of
from msg_defs.dxl_packet import encode
models = Models()
bus = BusDecoder(models)
servo = FakeDevice(1, models.by_name('MX-64'))
def ask(instruction, params=b''):
    reply = servo.execute(instruction, params, 0)
    wire = encode(1, instruction, params) + encode(1, 0x55, reply.params, reply.error)
    bus.process_chunk(wire, 1)
    return reply
ask(1)
ask(2, b'\\x84\\0\\4\\0')
known = bus.registry.devices[1].table.bytes(132, 4) is not None
print(name_of(0x21), ask(0x21).error, known, bus.registry.devices[1].table.bytes(132, 4))
""") == 'Home 0 True None'
    assert code.run('-c', """
from servobus.bus.decoder import Settings
from servobus.bus.expected_devices import Expected
from mecarover_fakes.dxl1_servo import Servo1
from servobus.model.models import Models
from servobus.monitor import Monitor
from msg_defs.dxl1_instruction import DYNAMIXEL_1, UNDECIDED
from msg_defs.dxl1_packet import encode
models = Models()
bus = Monitor('', models, Settings(1_000_000, (Expected(1, 'AX-12A'),), protocol='1'))
servo = Servo1(1, models.by_name('AX-12A'))
def ask(stamp, instruction, wire=b'', params=b''):
    reply = servo.execute(instruction, params, 0)
    bus.feed(encode(1, instruction, wire), stamp)
    bus.feed(encode(1, servo.error_byte(reply.error), reply.params), stamp + 300_000)
    return [one.field.name for one in bus.report(stamp + 300_000_000).devices[0].observed]
first = ask(10**11, 2, bytes((36, 2)), bytes((36, 0, 2, 0)))
known = [0x21 in one.entries for one in (DYNAMIXEL_1, UNDECIDED)]
print(first, *known, ask(10**11 + 10**9, 0x21))
""") == "['Present Position'] True True []"


    code.passes('test_fake_bus.py', 'the_truth_has_every_instruction')
    assert code.run('-c', """
from random import Random
from fuzz.instruction import check
from fuzz.script import INSTRUCTIONS
random = Random(1)
for _ in range(3000):
    check(bytes((INSTRUCTIONS.index(0x21), *random.randbytes(20))))
""") == ''


@pytest.mark.more
def test_a_finding(copy):
    code = copy('a finding')
    code.change('servobus/doctor/rules/devices.py',
                ('RULES = (', """\
@Rule(symptoms={'proof'})
def nameless(case: Case, device: DeviceReport) -> Found | None:
    \"\"\"
    No joint name.

    Do: name it in `devices`.
    \"\"\"
    return None if device.joint else Claim('it has no joint name; give it one')


"""),
                ('watchdog, too_hot', 'nameless, '), named='servobus/doctor/rules/FAMILY.py')
    assert 'doctor.md' in code.run('-m', 'docs.generate')
    code.change('test/doctor_edges.yaml', ('- rule: baud_moved', """\
- rule: nameless
  devices: [{id: 1}]
  says: it has no joint name; give it one
  too little:
  - devices: [{id: 1, joint: knee}]
"""))
    code.passes('test_doctor_edges.py', 'nameless')
    code.passes('test_value_findings.py', 'rests_on')
    code.passes('test_docs.py', 'generated_pages')
    code.passes('test_doctor_faults.py', 'every_rule')
    code.passes('test_doctor.py', 'every_rule', 2)
    assert code.run('-c', """
from servobus.bus.decoder import Settings
from servobus.bus.expected_devices import Expected
from servobus.model.models import Models
from servobus.monitor import Monitor
from servobus.status import device_status
report = Monitor('', Models(), Settings(devices=(Expected(1), Expected(2, '', 'hip')))).report(0)
for device in report.devices:
    print(dict(device_status('dxl_monitor', '', device, report.findings, False).values).get(
        'finding.nameless'))
""").splitlines() == ['it has no joint name; give it one', 'None']


@pytest.mark.more
def test_a_value_in_a_status(copy):
    code = copy('a value in a status')
    code.change('servobus/status.py', (
        "        'Missed in a Row':", '        keys.ERRORS: len(device.errors),\n'))
    code.change('docs/generate.py', (
        "    'Missed in a Row': ", "    'Kinds of Errors': 'refused so far',\n"))
    code.change('msg_defs/status_keys.py', ('UNOBSERVED_FIELDS =', "ERRORS = 'Kinds of Errors'\n"),
                ("           Figure('latency'",
                 "           Figure('errors', ERRORS, 'Errors', 'Kinds of errors', 0),\n"))
    assert 'diagnostics.md' in code.run('-m', 'docs.generate')
    code.passes('test_bus_status.py', 'documented')
    code.passes('test_docs.py', 'generated')
    assert code.run('-c', """
from servobus.bus.decoder import Settings
from servobus.bus.expected_devices import Expected
from servobus.model.models import Models
from servobus.monitor import Monitor
from servobus.status import device_status
from mecarover_dashboard.page_files import page_files
from mecarover_dashboard.state import State, TABLES
import sys
sys.path.insert(0, 'test')
from synthetic_robot import serialise
report = Monitor('', Models(), Settings(devices=(Expected(1),))).report(0)
state = State()
status = device_status('dxl_monitor', '', report.devices[0], (), True)
state.store_message(TABLES, serialise([status]), 1.0)
[row] = state.changes(0)['devices'].values()
print(row['errors'], b'"Kinds of errors"' in page_files()['figures.js'])
""") == '0 True'


@pytest.mark.more
def test_a_usb_adapter_family(copy):
    code = copy('a USB adapter family')
    code.change('servobus/sources/adapters.py', ('# All that is understood.', """\
class Xr21(Adapter):
    name = 'XR21'

    @classmethod
    def matches(cls, identity: UsbIdentity) -> bool:
        return identity.vendor == 0x04E2

    @classmethod
    def is_set_up_by(cls, setup: Setup, data: bytes) -> bool:
        return setup[:2] == (_VENDOR_OUT, 0x55)

    def control(self, setup: Setup, data: bytes) -> list[Change]:
        if not self.is_set_up_by(setup, data):
            return []
        return [Change(BAUD, int.from_bytes(data[:4], 'little'))]


"""), ('Ftdi, CdcAcm, Ch341', 'Xr21, '))
    code.change('mecarover_fakes/usb_adapter.py', ("    'cp210x': Family(", """\
    'xr21': Family(0x04E2, 0x1410, 0x0003, 64, (0x81, 0x01), 0xFF, lambda baud: [
        (_setup(0x40, 0x55, 0, 0, 4), baud.to_bytes(4, 'little'))]),
"""))
    code.change('docs/wiring.md', ('CDC-ACM, CH340', 'XR21, '))
    code.passes('test_usb.py', 'family or xr21 or descriptors', 20)


@pytest.mark.more
def test_a_topic(copy):
    code = copy('a topic')
    code.change('servobus/bus_statistics.py', (
        "                  ('error_rate', 'Hz'", "                  ('look_rate', 'Hz', 3.0),\n"))
    code.change('docs/generate.py', ("    'packet_rate': ", "    'look_rate': 'heard so far',\n"))
    code.change('config/sros2_policy.xml', (
        '            <topic>dxl/timing/ttyUSB0/packet_rate_hz</topic>\n',
        '            <topic>dxl/timing/ttyUSB0/look_rate_hz</topic>\n'))
    assert 'diagnostics.md' in code.run('-m', 'docs.generate')
    assert 'heard so far' in (code.folder / 'docs' / 'diagnostics.md').read_text()
    assert code.run('-c', """
from servobus.model.models import Models
from servobus.monitor import Monitor
from msg_defs.diagnostics import metric_status
[metric] = [one for one in Monitor('', Models()).report(0).metrics if one.name == 'look_rate']
print(metric_status('dxl_monitor', metric).name, metric.value)
""") == 'dxl_monitor: timing/look_rate 3.0'


def test_a_source(copy):
    code = copy('a source of bytes')
    code.change('servobus/sources/source.py', ('class File(', """\
class Hex(Source):
    def __init__(self, text: str) -> None:
        super().__init__()
        self._data = bytes.fromhex(text)

    def chunks(self) -> Iterator[Chunk | None]:
        yield Chunk(1, 'hex', self._data)


"""))
    code.change('servobus/sources/opening.py', ("    if name == '-':\n", """\
    if name.startswith('hex:'):
        from servobus.sources.source import Hex

        return Hex(name.removeprefix('hex:'))
"""))
    said = code.run('-m', 'servobus.tools.dxl_dump', 'hex:fffffd0001030001194e')
    assert 'Ping' in said


def test_a_live_source(copy):
    code = copy('a live source, for node and tools')
    code.change('servobus/sources/hex_listener.py', ('', """\
import time

from msg_defs.event import Chunk
from servobus.sources.listener import Listener


class HexListener(Listener):
    def _listen_once(self) -> None:
        self._set_open('open')
        self._deliver(Chunk(time.monotonic_ns(), self._bus,
                            bytes.fromhex(self.port.removeprefix('hex:'))))
        while not self._stopping:
            self._pause(1.0)
"""), named='servobus/sources/')
    code.change('servobus/sources/source_name.py',
                ("TAP, USB = 'tap:'", "HEX = 'hex:'\n"), ('TAP, USB)              #', 'HEX, '))
    code.change('servobus/sources/listeners.py',
                ('from servobus.sources.listener import',
                 'from servobus.sources.hex_listener import HexListener\n'),
                ('TAP: TapListener', "'hex:': HexListener, "))
    said = code.run('-m', 'servobus.tools.dxl_dump', '--count', '1',
                    'hex:fffffd0001030001194e')
    assert 'Ping' in said
