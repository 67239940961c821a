# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What each launch file must show, told through topics only.

The same scenarios run against `ros2 launch`ed nodes (test_launch.py) and against plain processes
(test_launch_plain.py); a starter brings up what `CASTS` lists. No ROS import here.
"""
from pathlib import Path

from harness import wait

CONFIG = Path(__file__).parents[1] / 'config'
OK, WARN, ERROR = range(3)
LOST_ID = 7
DRIVE = 0.3
# Seconds: late enough for a slow start on a busy machine, short enough to wait for.
VANISH = '--vanish', '12:2'
DEVICES = '1-20:MX-64'
SILENT = f'silent:{LOST_ID}:10:5'

# Per launch file: the fakes beside it (module, arguments), its launch arguments, and the nodes it
# starts, in the words of a plain process.
CASTS = {
    'bridge': {
        'fakes': [('mecarover_fakes.fake_mcu', '--link', '{folder}/mcu', *VANISH)],
        'launch': {'port': '{folder}/mcu'},
        'nodes': [('vel2d_bridge.main', 'bridge.yaml', 'port:={folder}/mcu')],
    },
    'monitor': {
        'fakes': [('mecarover_fakes.fake_bus', '--link', '{folder}/bus', '--devices', DEVICES,
                   '--fault', SILENT)],
        'launch': {'ports': '{folder}/bus', 'devices': f"['{DEVICES}']"},
        'nodes': [('dxl_monitor.start', 'monitor.yaml', 'ports:={folder}/bus',
                   f"devices:=['{DEVICES}']")],
    },
    'suite': {
        'fakes': [('mecarover_fakes.fake_mcu', '--link', '{folder}/mcu'),
                  ('mecarover_fakes.fake_bus', '--link', '{folder}/bus')],
        'launch': {'port': '{folder}/mcu', 'ports': '{folder}/bus', 'namespace': 'rover'},
        'nodes': [('vel2d_bridge.main', 'bridge.yaml', 'port:={folder}/mcu', '__ns:=/rover'),
                  ('dxl_monitor.start', 'monitor.yaml', 'ports:={folder}/bus', '__ns:=/rover')],
    },
    'demo': {
        'fakes': [],
        'launch': {'fault': SILENT, 'dashboard_port': '0'},
        'nodes': [('mecarover_fakes.fake_mcu', '--link', '{folder}/mcu'),
                  ('mecarover_fakes.fake_bus', '--link', '{folder}/bus', '--devices', DEVICES,
                   '--fault', SILENT),
                  ('vel2d_bridge.main', 'bridge.yaml', 'port:={folder}/mcu'),
                  ('dxl_monitor.start', 'monitor.yaml', 'ports:={folder}/bus',
                   f"devices:=['{DEVICES}']")],
    },
}


def status(namespace, name):
    """Return the name of a status whose node is in a namespace."""
    return f'{namespace}/{name}'.lstrip('/')


def link(namespace):
    return status(namespace, 'vel2d_bridge: link')


def commands(namespace):
    return status(namespace, 'vel2d_bridge: commands')


def monitor(namespace, part):
    return status(namespace, f'dxl_monitor: {part}')


def device(namespace):
    return monitor(namespace, f'{LOST_ID:03}')


def bridge_is_ready(graph, ros, namespace=''):
    graph.wait_status(link(namespace), 'State=open', level=OK)


def bridge_drives_and_times_out(graph, ros, namespace=''):
    publisher = graph.publisher(f'{namespace}/cmd_vel')
    with ros.Teleop(publisher, lambda: ros.twist(x=DRIVE), rate=20.0):
        graph.wait_status(commands(namespace), 'driving')
        graph.wait_status(link(namespace), f'Last x (m/s)={DRIVE}')
    graph.wait_status(link(namespace), 'Last x (m/s)=0\n')
    graph.wait_status(commands(namespace), 'State=stopped')
    values = graph.values(commands(namespace))
    # A busy machine that holds up the bridge for 0.2 s stops the rover before the time-out does.
    assert int(values['Time-outs']) or int(values['Stops: bridge was frozen'])
    graph.node.destroy_publisher(publisher)


def bridge_refuses_nonsense(graph, ros, namespace=''):
    publisher = graph.publisher(f'{namespace}/cmd_vel')
    with ros.Teleop(publisher, lambda: ros.twist(x=float('nan')), rate=20.0):
        wait(lambda: graph.values(commands(namespace))['Refused: not finite'] != '0')
    assert graph.values(commands(namespace))['State'] == 'stopped'
    graph.node.destroy_publisher(publisher)


def bridge_finds_a_lost_port_again(graph, ros, namespace=''):
    graph.wait_status(link(namespace), 'Losses=1', level=ERROR)
    graph.wait_status(link(namespace), 'State=open', 'Reopenings=1', level=OK)


def monitor_hears_its_devices(graph, ros, namespace=''):
    graph.wait_status(monitor(namespace, 'bus'), 'Devices=')
    graph.wait_status(device(namespace), 'State=connected')


def monitor_knows_the_models(graph, ros, namespace=''):
    graph.wait_status(device(namespace), 'Model=MX-64', 'State=connected')


def monitor_loses_and_finds_a_device(graph, ros, namespace=''):
    graph.wait_status(device(namespace), 'State=disconnected', level=ERROR)
    assert sum(other.startswith(monitor(namespace, '0')) for other in graph.statuses) > 1
    graph.wait_status(device(namespace), 'State=connected')


def topics_are_where_they_belong(graph, ros, namespace=''):
    """In a namespace: everything but /diagnostics, which tools want at the root."""
    wanted = {'/diagnostics', *(f'{namespace}/{name}' for name in (
        'cmd_vel', 'vel2d/timing', 'dxl/diagnostics', 'dxl/timing'))}
    wait(lambda: wanted <= {name for name, _ in graph.node.get_topic_names_and_types()})


SCENARIOS = {
    'bridge': [bridge_is_ready, bridge_drives_and_times_out, bridge_refuses_nonsense,
               bridge_finds_a_lost_port_again],
    'monitor': [monitor_knows_the_models, monitor_loses_and_finds_a_device],
    'suite': [bridge_is_ready, monitor_hears_its_devices, topics_are_where_they_belong,
              bridge_drives_and_times_out],
    'demo': [bridge_is_ready, bridge_drives_and_times_out, monitor_knows_the_models,
             monitor_loses_and_finds_a_device],
}


def namespace(name):
    """Return the namespace of a case, '/rover' or ''."""
    given = CASTS[name]['launch'].get('namespace', '')
    return f'/{given}' if given else ''


def play(name, graph, ros):
    """Run every scenario of a launch file, in order."""
    for scenario in SCENARIOS[name]:
        scenario(graph, ros, namespace(name))
