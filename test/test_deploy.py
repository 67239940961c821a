# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What deploy/ puts on a robot: rules and units that their own tools accept; and its undoing."""
import importlib
import json
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys

from deploy_under_systemd import kill_under_systemd
from deploy_under_systemd import why_no_systemd
import pytest
import yaml

ROOT = Path(__file__).parents[1]
INSTALLER = ROOT / 'deploy/install.py'
UNITS = ('vel2d_bridge.service', 'dxl_monitor.service', 'dxl_dashboard.service')
USB = {'ID_BUS': 'usb', 'ID_VENDOR_ID': '0403', 'ID_MODEL_ID': '6014',
       'ID_SERIAL_SHORT': 'FT4TFSGE', 'ID_USB_INTERFACE_NUM': '00', 'ID_PATH': 'usb-0:1:1.0'}


@pytest.fixture
def robot(tmp_path, monkeypatch):
    """Make a root to install into, a prefix with the nodes, and a udevadm that knows USB."""
    prefix = tmp_path / 'ws/install/mecarover_serial'
    for unit in UNITS:
        executable = prefix / 'lib/mecarover_serial' / unit.partition('.')[0]
        executable.parent.mkdir(parents=True, exist_ok=True)
        executable.write_text('#!/bin/sh\n')
        executable.chmod(0o755)
    (prefix.parent / 'setup.bash').touch()
    tools = tmp_path / 'tools'
    tools.mkdir()
    udevadm = tools / 'udevadm'
    udevadm.write_text(f"""#!/bin/sh
echo "$*" >> {tmp_path}/asked
for name in ttyUSB0 ttyUSB1 ttyUSB
do case "$*" in *$name*) cat {tmp_path}/facts_$name && exit;; esac
done 2> /dev/null
exit 0
""")
    udevadm.chmod(0o755)
    monkeypatch.setenv('PATH', f'{tools}:{os.environ["PATH"]}')
    monkeypatch.syspath_prepend(str(INSTALLER.parent))
    robot = Robot(tmp_path, prefix)
    robot.facts(USB)
    return robot


class Robot:
    """Runs the installer against a folder."""

    def __init__(self, folder, prefix):
        self._folder = folder
        self.root = folder / 'root'
        self.prefix = prefix
        self.root.mkdir()

    def facts(self, facts, device='ttyUSB'):
        (self._folder / f'facts_{device}').write_text(
            ''.join(f'{k}={v}\n' for k, v in facts.items()))

    def run(self, *options, answer=''):
        return subprocess.run(
            [sys.executable, INSTALLER, '--root', self.root, '--prefix', self.prefix,
             '--user', 'ubuntu', *options], input=answer, capture_output=True, text=True,
            timeout=60)

    def install(self, *options):
        done = self.run('--mcu', '/dev/ttyAMA0', '--bus', '/dev/ttyUSB0', '--yes', *options)
        assert done.returncode == 0, done.stderr
        return done.stdout

    def uninstall(self):
        return self.run('--uninstall', '--yes')

    def read(self, path):
        return (self.root / path).read_text()

    def command(self):
        """Install, and return what the unit of the bridge starts."""
        self.install()
        [command] = re.findall('^ExecStart=(.*)$', self.read('etc/systemd/system/' + UNITS[0]),
                               re.M)
        return command

    def files(self):
        return sorted(str(path.relative_to(self.root))
                      for path in self.root.rglob('*') if path.is_file())


def test_usbmon_is_for_the_service_alone(robot):
    told = robot.install('--usbmon')
    assert 'keyboards and disks too' in told
    assert "ports: ['usb:/dev/mecarover_dxl']" in robot.read('etc/mecarover_serial/monitor.yaml')
    assert 'bauds: [0]' in robot.read('etc/mecarover_serial/monitor.yaml')
    group = re.search(r'GROUP="(\w+)", MODE="0640"', robot.read(
        'etc/udev/rules.d/71-mecarover_usbmon.rules'))[1]
    assert robot.read('etc/systemd/system/dxl_monitor.service.d/usbmon.conf') == (
        f'[Service]\nSupplementaryGroups={group}\n')
    assert robot.read('etc/modules-load.d/mecarover_usbmon.conf') == 'usbmon\n'
    assert 'usermod' not in told
    assert 'nothing to do' in robot.install('--usbmon')
    robot.uninstall()
    assert not [file for file in robot.files() if 'usbmon' in file]
    assert not (robot.root / 'etc/systemd/system/dxl_monitor.service.d').exists()
    robot.install('--usbmon')
    edited = robot.root / 'etc/systemd/system/dxl_monitor.service.d/override.conf'
    edited.touch()
    robot.uninstall()
    assert edited.exists()                          # as `systemctl edit` makes it
    refused = robot.run('--mcu', '/dev/ttyAMA0', '--usbmon', '--yes')
    assert (refused.returncode, refused.stderr) == (
        1, 'install: --usbmon: no adapter given; give --bus DEVICE\n')


def test_installs_everything_and_nothing_twice(robot):
    robot.install()
    assert robot.files() == [
        'etc/mecarover_serial/bridge.yaml', 'etc/mecarover_serial/environment',
        'etc/mecarover_serial/monitor.yaml', 'etc/systemd/system/dxl_monitor.service',
        'etc/systemd/system/vel2d_bridge.service',
        'etc/udev/rules.d/70-mecarover_serial.rules']
    assert robot.install().endswith('\ninstall: nothing to do\n')


def test_the_page_alone_and_its_undoing(robot):
    done = robot.run('--dashboard', '--yes')
    assert done.returncode == 0, done.stderr
    unit = robot.read('etc/systemd/system/dxl_dashboard.service')
    assert '\nStateDirectory=mecarover_dashboard\n' in unit
    assert re.search(r'^ExecStart=.*/dxl_dashboard \$DXL_DASHBOARD_OPTIONS$', unit, re.M)
    assert robot.files() == [
        'etc/mecarover_serial/environment', 'etc/systemd/system/dxl_dashboard.service',
        'etc/udev/rules.d/70-mecarover_serial.rules']
    assert robot.run('--dashboard', '--yes').stdout == 'install: nothing to do\n'
    assert robot.uninstall().returncode == 0
    assert 'etc/systemd/system/dxl_dashboard.service' not in robot.files()


def test_shows_and_asks_before_it_does(robot):
    options = ('--mcu', '/dev/ttyAMA0')
    shown = robot.run(*options, '--dry-run')
    assert shown.returncode == 0
    assert '    | User=ubuntu\n' in shown.stdout
    for answer in ('n\n', ''):                     # or there is none: Ctrl-D
        refused = robot.run(*options, answer=answer)
        assert (refused.returncode, refused.stderr) == (1, '')
        assert 'nothing was changed' in refused.stdout
    assert robot.files() == []
    assert robot.run(*options, answer='y\n').returncode == 0
    assert 'etc/systemd/system/vel2d_bridge.service' in robot.files()


def test_settings_name_the_stable_ports(robot):
    robot.install('--bus', 'left=/dev/ttyUSB1')
    assert '    port: /dev/mecarover_mcu\n' in robot.read('etc/mecarover_serial/bridge.yaml')
    assert "    ports: ['/dev/mecarover_dxl', '/dev/mecarover_dxl_left']\n" \
        in robot.read('etc/mecarover_serial/monitor.yaml')


def name_rules(*links):
    return importlib.import_module('device_names').name_rules(links)


def test_what_is_no_serial_port_is_refused(robot):
    robot.facts({'SUBSYSTEM': 'mem'})
    refused = importlib.import_module('device_names').InstallError
    with pytest.raises(refused, match='/dev/ttyUSB0: not a serial port; give'):
        name_rules(('/dev/ttyUSB0', '/dev/mecarover_mcu'))


def test_services_of_root_are_said(robot):
    done = robot.run('--mcu', '/dev/ttyUSB0', '--user', 'root', '--yes')
    assert 'note: the services will run as root; give --user NAME' in done.stdout


def test_edited_settings_survive(robot):
    robot.install()
    settings = robot.root / 'etc/mecarover_serial/bridge.yaml'
    settings.write_text('mine')
    robot.install()
    assert settings.read_text() == 'mine'
    assert robot.uninstall().returncode == 0
    assert (robot.root / 'etc/mecarover_serial.removed/bridge.yaml').read_text() == 'mine'


def test_uninstall_leaves_only_the_settings_aside(robot):
    robot.install()
    assert robot.uninstall().returncode == 0
    assert {Path(name).parts[1] for name in robot.files()} == {'mecarover_serial.removed'}
    again = robot.uninstall()
    assert (again.returncode, again.stdout) == (0, 'install: nothing to do\n')


@pytest.mark.parametrize('facts, rule', [
    (USB, 'ENV{ID_VENDOR_ID}=="0403", ENV{ID_MODEL_ID}=="6014", ENV{ID_SERIAL_SHORT}=="FT4TFSGE", '
          'ENV{ID_USB_INTERFACE_NUM}=="00", SYMLINK+="mecarover_dxl", TAG+="systemd"'),
    ({k: v for k, v in USB.items() if k != 'ID_SERIAL_SHORT'},
     'ENV{ID_PATH}=="usb-0:1:1.0", SYMLINK+="mecarover_dxl", TAG+="systemd"'),
])
def test_an_adapter_is_known_by_its_serial_number_or_its_socket(robot, facts, rule):
    robot.facts(facts)
    assert name_rules(('/dev/ttyAMA0', '/dev/mecarover_mcu'),
                      ('/dev/ttyUSB0', '/dev/mecarover_dxl')) == [
        'KERNEL=="ttyAMA0", SYMLINK+="mecarover_mcu", TAG+="systemd"', rule]


def test_an_image_is_not_asked_of_the_udev_of_this_machine(robot, tmp_path):
    told = robot.install('--bus', 'left=/dev/serial/by-id/usb-FTDI-if00-port0')
    assert not (tmp_path / 'asked').exists()
    rules = robot.read('etc/udev/rules.d/70-mecarover_serial.rules').splitlines()
    for rule in ('KERNEL=="ttyAMA0", SYMLINK+="mecarover_mcu", TAG+="systemd"',
                 'KERNEL=="ttyUSB0", SYMLINK+="mecarover_dxl", TAG+="systemd"',
                 'SYMLINK=="serial/by-id/usb-FTDI-if00-port0", SYMLINK+="mecarover_dxl_left", '
                 'TAG+="systemd"'):
        assert rule in rules
    [note] = [line for line in told.splitlines() if line.startswith('note: --root: ')]
    assert '/dev/mecarover_dxl will be any adapter that is called ttyUSB0 there' in note


@pytest.mark.parametrize('buses', [
    ('/dev/ttyUSB0', '/dev/ttyUSB1'), ('left=/dev/ttyUSB0', 'left=/dev/ttyUSB1')])
@pytest.mark.parametrize('is_here', [True, False])
def test_two_buses_with_one_name_are_refused(robot, buses, is_here):
    names = importlib.import_module('device_names')
    with pytest.raises(names.InstallError, match=r'^--bus: two would be /dev/mecarover_dxl\S*; '
                       'give each its name, as --bus left='):
        names.name_rules([names.parse_bus(text) for text in buses], is_here)


@pytest.mark.parametrize(('link', 'where'), [
    ('{outside}', '{outside}'), ('../outside', '/outside')])
def test_links_of_an_image_lead_nowhere_else(robot, tmp_path, link, where):
    outside = tmp_path / 'outside'
    (outside / 'systemd').mkdir(parents=True)
    (robot.root / 'etc').symlink_to(link.format(outside=outside))
    robot.install()
    assert robot.install().endswith('\ninstall: nothing to do\n')
    assert [path for path in outside.rglob('*') if path.is_file()] == []
    [unit] = robot.root.rglob('vel2d_bridge.service')
    assert str(unit) == (f'{robot.root}{where.format(outside=outside)}'
                         '/systemd/system/vel2d_bridge.service')
    assert robot.uninstall().returncode == 0
    assert list(robot.root.rglob('vel2d_bridge.service')) == []


def test_a_unit_that_is_a_link_is_replaced_not_followed(robot, tmp_path):
    """As `systemctl mask` leaves it; the file at its end belongs to this machine."""
    (tmp_path / 'null').write_text('of this machine')
    unit = robot.root / 'etc/systemd/system/vel2d_bridge.service'
    unit.parent.mkdir(parents=True)
    unit.symlink_to(tmp_path / 'null')
    robot.install()
    assert (tmp_path / 'null').read_text() == 'of this machine'
    assert not unit.is_symlink()
    assert unit.is_file()


def test_links_in_a_circle_are_one_line(robot):
    (robot.root / 'etc').symlink_to('etc')
    done = robot.run('--mcu', '/dev/ttyAMA0', '--yes')
    assert (done.returncode, len(done.stderr.splitlines())) == (1, 1)
    assert 'too many links' in done.stderr


def test_two_adapters_with_one_serial_number_are_known_by_their_sockets(robot, capsys):
    for number in (0, 1):
        robot.facts({**USB, 'ID_PATH': f'usb-0:{number}'}, f'ttyUSB{number}')
    rules = name_rules(('/dev/ttyUSB0', '/dev/mecarover_dxl'),
                       ('/dev/ttyUSB1', '/dev/mecarover_dxl_left'))
    assert ('note: /dev/ttyUSB1 has the same serial number as another adapter, FT4TFSGE: its name '
            'belongs to') in capsys.readouterr().out
    for number, name in enumerate(('mecarover_dxl', 'mecarover_dxl_left')):
        assert f'ENV{{ID_PATH}}=="usb-0:{number}", SYMLINK+="{name}", TAG+="systemd"' in rules


@pytest.mark.parametrize('options, words', yaml.safe_load(
    Path(__file__).with_name('deploy_mistakes.yaml').read_text(encoding='utf-8')))
def test_a_mistake_is_one_line(robot, options, words):
    done = robot.run('--yes', *options)
    assert done.returncode == 1
    assert words in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert robot.files() == []


def test_a_workspace_is_sourced_and_a_venv_is_not(robot):
    assert f'{robot.prefix.parent}/setup.bash' in robot.command()
    (robot.prefix / 'pyvenv.cfg').touch()
    assert robot.command().startswith(
        f'{robot.prefix}/lib/mecarover_serial/vel2d_bridge --ros-args')
    (robot.prefix / 'bin').mkdir()
    (robot.prefix / 'bin/vel2d_bridge').touch()
    assert robot.command().startswith(
        f'{robot.prefix}/bin/vel2d_bridge --ros-args'), 'its own Python'


def test_the_command_line_survives_systemd(robot, tmp_path):
    """What systemd makes of `$$`, bash must make of the arguments."""
    if shutil.which('bash') is None:
        pytest.skip('skipped: no bash here')
    (robot.prefix.parent / 'setup.bash').write_text('export SOURCED=yes\n')
    node = robot.prefix / 'lib/mecarover_serial/vel2d_bridge'
    node.write_text('#!/bin/sh\necho "$SOURCED $*"\n')
    command = robot.command()
    said = 'yes --ros-args --params-file /etc/mecarover_serial/bridge.yaml ' \
        '-p disabled_file:=%S/mecarover_serial/bridge_disabled'
    for more in ('', ' --enclave /vel2d_bridge'):
        done = subprocess.run(['bash', '-c', command.replace('$$', '$')], capture_output=True,
                              text=True, env={**os.environ, 'VEL2D_BRIDGE_ROS_ARGS': more})
        assert done.stdout == f'{said}{more}\n'


@pytest.mark.parametrize('unit', UNITS)
def test_units_pass_systemd_analyze(robot, unit):
    if shutil.which('systemd-analyze') is None:
        pytest.skip('skipped: no systemd-analyze here')
    robot.install('--dashboard')
    path = robot.root / 'etc/systemd/system' / unit
    assert not re.search('@[A-Z]+@', path.read_text())
    done = subprocess.run(['systemd-analyze', 'verify', '--man=no', path], capture_output=True,
                          text=True, timeout=60)
    complaints = [line for line in done.stderr.splitlines() if unit in line]
    assert (done.returncode, complaints) == (0, [])


def test_rules_pass_udevadm(robot):
    robot.install()
    real = shutil.which('udevadm', path='/usr/bin:/bin:/sbin:/usr/sbin')
    if real is None or subprocess.run([real, 'verify', '--help'], capture_output=True).returncode:
        pytest.skip('skipped: no udevadm verify here (systemd 254 or newer)')
    done = subprocess.run([real, 'verify', robot.root / 'etc/udev/rules.d'],
                          capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def test_device_units_are_named_as_systemd_names_them(robot):
    robot.install('--bus', 'left=/dev/ttyUSB1')
    text = robot.read('etc/systemd/system/dxl_monitor.service')
    assert 'After=dev-mecarover_dxl.device dev-mecarover_dxl_left.device\n' in text


@pytest.mark.ros
@pytest.mark.realtime(bears=0.1)
@pytest.mark.slow
@pytest.mark.skipif(bool(why_no_systemd()), reason=f'skipped: {why_no_systemd()}')
def test_the_dead_man_outlives_a_kill_of_the_service(robot, tmp_path):
    """
    Under a real systemd, with the unit as installed: kill -9 of the node stops the rover.

    KillMode=mixed, which looks safer, ends the child at once: the rover drives on.
    """
    robot.install()
    unit = robot.read('etc/systemd/system/vel2d_bridge.service')
    outcome = kill_under_systemd(unit, tmp_path)
    assert outcome['drove'], outcome
    assert outcome['stopped_after_s'] is not None, json.dumps(outcome)
    assert outcome['stopped_after_s'] < 0.3 + 0.5      # the machine may be busy
    assert outcome['left_over'] == []
