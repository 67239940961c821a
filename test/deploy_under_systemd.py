# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
A systemd of our own, in namespaces of our own, that runs the bridge as its unit file says.

Run as a program it is what lives inside: argument: the working folder with `unit` in it.
"""
import contextlib
import json
import os
from pathlib import Path
import re
import shutil
import signal
import subprocess
import sys
import time

ROOT = Path(__file__).parents[1]
SYSTEMD = Path('/lib/systemd/systemd')
DEADLINE_S = 30.0
PUBLISHER = """
import rclpy, time
from geometry_msgs.msg import Twist
rclpy.init()
publisher = rclpy.create_node('operator').create_publisher(Twist, 'cmd_vel', 1)
twist = Twist()
twist.linear.x = 0.3
while True:
    publisher.publish(twist)
    time.sleep(0.05)
"""
# What needs a machine, or a user manager may not do.
NOT_HERE = ('User', 'SupplementaryGroups', 'LogsDirectory', 'EnvironmentFile', 'Wants', 'After',
            'ExecStart', 'Environment', 'Documentation', 'OOMScoreAdjust', 'Restart', 'WantedBy',
            'ProtectSystem', 'ProtectControlGroups', 'NoNewPrivileges', 'RestrictRealtime')


def why_no_systemd():
    """Say why this machine cannot run the experiment; '' when it can."""
    if os.geteuid() != 0:
        return 'a systemd of our own needs root'
    if not SYSTEMD.exists() or shutil.which('unshare') is None:
        return 'no systemd or no unshare here'
    inside = 'mount -t tmpfs tmpfs /run && mkdir /sys/fs/cgroup/systemd/mecarover_probe'
    tried = subprocess.run(['unshare', '-m', '-p', '-f', '--mount-proc', 'sh', '-c', inside],
                           capture_output=True)
    with contextlib.suppress(OSError):
        os.rmdir('/sys/fs/cgroup/systemd/mecarover_probe')
    return '' if tried.returncode == 0 else 'not allowed to make namespaces and control groups'


def kill_under_systemd(unit, folder):
    """Run the unit, kill -9 its main process while the rover drives; return what happened."""
    (folder / 'unit').write_text(unit)
    done = subprocess.run(
        ['unshare', '-m', '-p', '-f', '--mount-proc', '--kill-child', sys.executable, __file__,
         str(folder)], capture_output=True, text=True, timeout=180)
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def main(folder):
    subprocess.run(['mount', '-t', 'tmpfs', 'tmpfs', '/run'], check=True)
    os.makedirs('/run/systemd/system')
    os.makedirs('/run/us', mode=0o700)
    os.environ.update(XDG_RUNTIME_DIR='/run/us', XDG_CONFIG_HOME=str(folder / 'conf'))
    units = folder / 'conf/systemd/user'
    units.mkdir(parents=True)
    (units / 'bridge.service').write_text(adapt((folder / 'unit').read_text(), folder))
    with (folder / 'systemd.log').open('w') as log:
        manager = subprocess.Popen([SYSTEMD, '--user', '--log-target=console'],
                                   stdout=log, stderr=log)
    mcu = subprocess.Popen([sys.executable, '-m', 'mecarover_fakes.fake_mcu', '--json', '--link',
                            folder / 'mcu'], cwd=ROOT, stdout=(folder / 'mcu.log').open('w'))
    operator = subprocess.Popen([sys.executable, '-c', PUBLISHER])
    try:
        await_(lambda: systemctl('is-system-running').strip() in ('running', 'degraded'))
        systemctl('start', 'bridge.service')
        print(json.dumps(kill(folder)))
    finally:
        for process in (operator, mcu, manager):
            process.terminate()
            process.wait(10)


def adapt(unit, folder):
    """Return the unit for a user manager: what kills and restarts as installed, the rest ours."""
    kept = [line for line in unit.splitlines()
            if line.partition('=')[0] not in NOT_HERE and not line.startswith('#')]
    passed = ' '.join(f'"{name}={value}"' for name, value in os.environ.items()
                      if re.match('ROS_|RCUTILS|FASTRTPS|HOME|LD_LIB|_ROS|PATH|PYTHON', name))
    ours = (f'ExecStart={sys.executable} -m vel2d_bridge.main --ros-args -p port:={folder}/mcu\n'
            f'WorkingDirectory={ROOT}\nEnvironment={passed}')
    return '\n'.join(kept).replace('[Service]', f'[Service]\n{ours}') + '\n'


def kill(folder):
    log = folder / 'mcu.log'
    drove = await_(lambda: any(record['what'] == 'drive' for record in set_points(log)))
    pid = int(systemctl('show', '--property=MainPID', '--value', 'bridge.service'))
    family = [pid, *map(int, Path(f'/proc/{pid}/task/{pid}/children').read_text().split())]
    killed = time.monotonic()
    os.kill(pid, signal.SIGKILL)
    stops = await_(lambda: [record['stamp'] for record in set_points(log)
                            if record['stamp'] > killed and record['what'] == 'stop'], 3.0)
    gone = await_(lambda: not any(map(is_alive, family)), 10.0)
    return {'drove': bool(drove), 'stopped_after_s': stops[0] - killed if stops else None,
            'left_over': [] if gone else family, 'family': len(family)}


def is_alive(pid):
    try:
        return Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()[0] != 'Z'
    except OSError:
        return False


def set_points(log):
    """Return what the fake MCU took so far; its last line may be incomplete."""
    records = []
    for line in log.read_text().splitlines():
        with contextlib.suppress(ValueError):
            record = json.loads(line)
            if 'what' in record:
                records.append(record)
    return records


def await_(condition, deadline_s=DEADLINE_S):
    deadline = time.monotonic() + deadline_s
    while not (met := condition()) and time.monotonic() < deadline:
        time.sleep(0.02)
    return met


def systemctl(*arguments):
    return subprocess.run(['systemctl', '--user', *arguments], capture_output=True,
                          text=True).stdout


if __name__ == '__main__':
    main(Path(sys.argv[1]))
