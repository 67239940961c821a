# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""A case as a file, or as a port, through the mains of the tools."""

from collections import Counter
from contextlib import nullcontext
from contextlib import redirect_stderr
from contextlib import redirect_stdout
import gzip
import io
import json
import os
from pathlib import Path
import re
import struct
import sys
from types import SimpleNamespace
from unittest.mock import patch

from fuzz.whole.node import FedListener
from fuzz.whole.node import MODELS
from fuzz.whole.node import print_nothing
from fuzz.whole.node import WALL
from fuzz.whole.traffic import BAUDS
from fuzz.whole.traffic import BOOT
from fuzz.whole.traffic import damaged
from fuzz.whole.traffic import FAR
from fuzz.whole.traffic import PROTOCOLS
from mecarover_dashboard import mecarover_status as status
from mecarover_fakes.usb_adapter import FakeAdapter
from mecarover_fakes.usb_adapter import FAMILIES
from msg_defs.event import OUT
from rigs.usb_pcap import LINUX
from rigs.usb_pcap import MMAPPED
from rigs.usb_pcap import pcap
from rigs.usb_pcap import pcapng
from rigs.usb_pcap import USBPCAP
from servobus.sources import live
from servobus.tools import bus_options as common
from servobus.tools import dxl_doctor as doctor
from servobus.tools import dxl_dump as dump
from servobus.tools import replay
from servobus.tools.doctor import error_window

RUNS = Counter()
DUMP = (['--json'], ['--summary'], ['--stats'], ['--errors'], ['--full'],
        ['--id', '1,3'], ['--about', '2-5'], ['--instruction', 'read,status,0x83'],
        ['--count', '5'], ['-t', 'clock'], ['-t', 'epoch'], ['--color', 'always'], ['-b', '57600'],
        ['--devices', '1-6:XL430-W250'], ['--seconds', '0.5'])


def through_tools(case, capture, folder, chance):
    """Let two of the tools read a case as a file, or hear it as a port."""
    path = folder / 'heard'
    path.write_bytes(chance.choice(FORMS)(case, capture, chance))
    for _ in range(2):
        chance.choice((run_dump, run_dump, run_doctor, run_replay, run_status))(
            case, str(path), chance)


def usb(case, capture, chance):
    """Return it as the events of an adapter."""
    adapter = FakeAdapter(chance.choice(sorted(FAMILIES)))
    now = WALL if chance.random() < 0.9 else abs(chance.choice(FAR))
    whole = adapter.plug(now) + adapter.set_baud(case.baud or 9600, now)
    for one in case.heard:
        now += one.after_ns
        tell = adapter.sent if one.side == OUT else adapter.received
        if one.change is not None and one.change.value in BAUDS:
            whole += adapter.set_baud(one.change.value or 9600, now)
        if one.data:
            whole += tell(one.data, now if one.stamp is None else max(0, one.stamp))
    return whole


def packets(case, capture, chance):
    """Return the same as a pcap or pcapng file of any link type, with packets that are cut."""
    events, short = usb(case, capture, chance), chance.choice((0, 0, 0.05, 0.5))
    link, change = chance.choice((LINUX, MMAPPED, USBPCAP)), lambda data: (
        data[:chance.randrange(len(data))] if chance.random() < short else data)
    if chance.random() < 0.5:
        return pcap(link, events, change=change)
    digits = chance.choice((6, 9, chance.randrange(256)))
    return pcapng(link, events, change=change).replace(
        struct.pack('<HHB', 9, 1, 6), struct.pack('<HHB', 9, 1, digits), 1)


def raw(case, capture, chance):
    return b''.join(one.data for one in case.heard)


def spoil_file(case, capture, chance):
    """Return a file of any form with something wrong in it."""
    return damage_text(chance.choice(FORMS[:4])(case, capture, chance), chance)


def damage_text(data, chance):
    for _ in range(chance.choice((1, 5, 30))):
        at = chance.randrange(len(data) + 1)
        data = data[:at] + damaged(chance, data[at:at + 40]) + data[at + 40:]
    return data


FORMS = (lambda case, capture, chance: capture, usb, raw, packets, spoil_file)


def run_dump(case, path, chance):
    options = [part for one in chance.sample(DUMP, chance.choice((0, 1, 1, 2, 4))) for part in one]
    if chance.random() < 0.3:
        options += ['--protocol', chance.choice(PROTOCOLS)]
    if chance.random() < 0.4:
        options += ['-w', f'{path}.again']
    code, out = run_tool(dump, case, path, options, chance)
    if '--json' in options and '--stats' not in options and code == 0:
        *_, last = [{}, *map(json.loads, out.splitlines())]
        assert '--summary' not in options or last['bytes'] >= last['noise_bytes'] >= 0


def run_doctor(case, path, chance):
    options = chance.choice(([], ['--json'], ['--report', f'{path}.report']))
    sizes = 100, error_window.WINDOW_MAX_BYTES
    with patch.object(error_window, 'WINDOW_MAX_BYTES', chance.choice(sizes)):
        code, out = run_tool(doctor, case, path, options, chance)
    if '--json' in options and out:
        json.loads(out)
    if '--report' in options and Path(f'{path}.report').exists():
        again, _ = run_tool(doctor, None, f'{path}.report', [], chance)
        assert again == code, (again, code)
        text = damage_text(Path(f'{path}.report').read_bytes(), chance)
        Path(f'{path}.report').write_bytes(gzip.compress(text) if chance.random() < 0.2 else text)
        run_tool(doctor, None, f'{path}.report', [], chance)
        Path(f'{path}.report').unlink()
    if chance.random() < 0.1:              # it reads a large file
        text = ascii(case.names[0]) + chance.choice(('', 'no status packet', 'TxRxResult'))
        run_tool(doctor, None, '', ['--explain', text], chance)


def run_replay(case, path, chance):
    with open(os.devnull, 'wb') as nowhere, patch.object(
            replay, 'Pty', lambda link: nullcontext(SimpleNamespace(
                is_open=True, link=None, path='/dev/pts/9', master=nowhere.fileno(),
                let_go=lambda: None))), patch.object(
            replay, 'time', SimpleNamespace(monotonic=lambda: 0.0, sleep=print_nothing)):
        options = chance.choice((['--speed', '0'], ['--side', 'out'], []))
        run_tool(replay, None, path, options, chance)


def run_status(case, path, chance):
    run_tool(status, None, path, ['--once', '--wait', '0.001', '--all'], chance)


def run_tool(module, case, path, options, chance):
    """Run a tool on a file, or on a port where the case is heard; return its code and output."""
    def listener_on(*arguments, **more):
        fed = FedListener(*arguments, **more)
        fed.after = lambda: [fed.hear_chunk(one, BOOT + at) for at, one in enumerate(case.heard)]
        fed.news = end
        return fed

    def end():
        raise KeyboardInterrupt            # as a user does when nothing comes any more

    if case is not None and chance.random() < 0.2:
        path = 'tap:x'
    out, err = (io.TextIOWrapper(io.BytesIO(), encoding='utf-8') for _ in range(2))
    out.isatty = lambda: path == 'tap:x'
    name = {replay: 'dxl_replay'}.get(module, module.__name__.rpartition('.')[2])
    RUNS[name] += 1
    with redirect_stdout(out), redirect_stderr(err), patch.object(
            sys, 'argv', [name, *options, *filter(None, [path])]), patch.object(
            common, 'load_models', lambda _: MODELS), patch.object(
            live, 'listener_on', listener_on), patch.object(live, 'TICK_S', 0):
        code = module.main()
    out.seek(0)
    err.seek(0)
    said = out.read()
    assert code in (0, 1, 2, 3, 4), code
    assert all(line.startswith(f'{name}: ') for line in err) or code == 2
    assert path == 'tap:x' or re.sub('\033\\[[0-9;]*m', '', said).replace('\n', '').isprintable()
    return code, said
