# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What the documentation promises: links lead somewhere, commands exist, figures hold."""
import ast
from functools import cache
import json
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

from harness import Program
from harness import wait
import pytest
import yaml

from docs.generate import BRIDGE
from docs.generate import MONITOR
from docs.generate import PAGES
from mecarover_serial import launch_arguments
from mecarover_serial.command import COMMANDS
from mecarover_serial.launch_arguments import arguments_of
from servobus.doctor import RULES

ROOT = Path(__file__).parents[1]
PAGES_BY_HAND = [ROOT / 'README.md', ROOT / 'CONTRIBUTING.md', *sorted(ROOT.glob('docs/*.md'))]
SETTINGS = {'bridge.yaml': BRIDGE, 'monitor.yaml': MONITOR}
TOOLS = {path.name for path in (ROOT / 'resource/executables').iterdir()}
# Programs of others that our pages name.
FOREIGN = {'cd', 'git', 'mkdir', 'source', 'rosdep', 'colcon', 'ros2', 'sudo', 'systemctl',
           'journalctl', 'rqt_plot', 'export', 'ssh', 'pip', 'xset', 'python', 'python3', 'jq',
           'docker'}


# Its entry points, pyproject.toml of huggingface/lerobot 7427f31.
LEROBOT = {f'lerobot-{name}' for name in (
    'calibrate', 'find-cameras', 'find-port', 'record', 'replay', 'setup-motors', 'teleoperate',
    'eval', 'train', 'train-tokenizer', 'dataset-viz', 'info', 'find-joint-limits',
    'imgtransform-viz', 'edit-dataset', 'setup-can', 'annotate', 'rollout')}


def pages():
    return pytest.mark.parametrize('page', PAGES_BY_HAND, ids=lambda page: page.name)


def commands(page):
    """
    Yield the commands of a page's bash blocks, one per && or | part, joined lines.

    Programs of the venv that the README makes are named as if it were active.
    """
    for block in re.findall(r'^```bash\n(.*?)^```', page.read_text(), re.M | re.S):
        for line in block.replace('\\\n', ' ').splitlines():
            for part in filter(None, map(str.strip, re.split(r'&&|\|', line))):
                yield part.removeprefix('~/dxl/bin/')


def anchor(heading):
    """Spell a heading as its link does."""
    return re.sub(r'[^\w\- ]', '', heading.strip().lower()).replace(' ', '-')


@pages()
def test_relative_links_lead_somewhere(page):
    text = re.sub(r'^```.*?^```', '', page.read_text(), flags=re.M | re.S)
    for target in re.findall(r'\]\(([^)\s]+)\)', text):
        if '://' in target:
            continue
        path, _, name = target.partition('#')
        there = (page.parent / path) if path else page
        assert there.exists(), f'{page.name}: {target}'
        if name and there.suffix == '.md':
            headings = re.findall(r'^#+ (.*)$', there.read_text(), re.M)
            assert name in map(anchor, headings), f'{page.name}: {target}'


@pages()
def test_commands_name_what_exists(page):
    for command in commands(page):
        words = [word for word in command.split() if not re.match(r'\w+=', word)]
        if not words or words[0].startswith('#'):
            continue
        program = words[0]
        if '/' in program:
            file = re.sub(r'^(~/ws/|\./)?(src/mecarover_serial/)?', '', program)
            assert (ROOT / file).exists() or file.startswith('.venv/'), command
        else:
            assert program in TOOLS | FOREIGN, command
        if words[:3] == ['ros2', 'launch', 'mecarover_serial']:
            check_launch(words[3:])
        if words[:3] == ['ros2', 'run', 'mecarover_serial']:
            assert words[3] in TOOLS, command
        for name in re.findall(r'-p "?(\w+):=', command):
            assert name in known_parameters() | {'stamped'}, command


def check_launch(words):
    file, *given = words
    text = (ROOT / 'launch' / file).read_text()
    nodes = re.search(r'describe_nodes\(__file__, (.*)\)', text)
    known = {one.name for one in arguments_of(*(
        getattr(launch_arguments, node) for node in nodes[1].split(', ')))} if nodes else set()
    for name in (argument.partition(':=')[0] for argument in given if ':=' in argument):
        assert name in known or f"'{name}'" in text, name


def known_defaults():
    return {one.name: one.default for one in (*BRIDGE, *MONITOR)}


def known_parameters():
    return {one.name for one in (*BRIDGE, *MONITOR)}


@pages()
def test_own_options_exist(page):
    """Every --option after one of our tools is in its --help; those after -- are of others."""
    for command in commands(page):
        command = command.partition(' -- ')[0]
        program = command.removeprefix('ros2 run mecarover_serial ').split()[0]
        if program in TOOLS - {'vel2d_bridge', 'dxl_monitor'} or program.startswith('deploy/'):
            known = help_text(program)
            for option in re.findall(r'(?<=\s)--[\w-]+', command.partition(' # ')[0]):
                assert option in known, command


@cache
def help_text(program):
    file = ROOT / program if '/' in program else ROOT / 'resource/executables' / program
    done = subprocess.run([sys.executable, file, '--help'], capture_output=True, text=True,
                          env={**os.environ, 'PYTHONPATH': str(ROOT)}, timeout=60)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pages()
def test_commands_of_lerobot_exist(page):
    named = set(re.findall(r'lerobot-[a-z]+(?:-[a-z]+)*\b(?!\.\.)', page.read_text()))
    assert named <= LEROBOT


@pytest.mark.parametrize('page', ['symptoms', 'so101', 'openmanipulator'])
def test_findings_that_a_page_names_exist(page):
    text = re.sub(r'^```.*?^```', '', (ROOT / f'docs/{page}.md').read_text(), flags=re.M | re.S)
    named = set(re.findall(r'`([a-z]+(?:_[a-z]+)+)`', text))
    assert named <= {rule.name for rule in RULES} | TOOLS | {'koch_follower', 'omx_follower'}


@pytest.mark.parametrize('words', [
    'hums', 'spins', 'drift', 'wrong position', 'Bricked', 'factory reset', 'firmware update',
    '4294967295', 'above 4095', 'after ten minutes', 'stopped working', 'ignores commands',
    'laptop', 'Raspberry Pi'])
def test_what_people_look_for_is_a_symptom(words):
    rows = (ROOT / 'docs/symptoms.md').read_text().splitlines()
    assert any(words in row.split('|')[1] for row in rows if row.startswith('|'))


def linked(page):
    """Return the pages that a page links to."""
    targets = re.findall(r'\]\(([^)\s#]+\.md)', page.read_text())
    return {(page.parent / target).resolve() for target in targets if '://' not in target}


def test_every_page_is_reached_from_the_readme():
    reached, waiting = set(), {ROOT / 'README.md'}
    while waiting:
        page = waiting.pop()
        reached.add(page)
        waiting |= {other for other in linked(page) if other.exists()} - reached
    assert set(ROOT.glob('docs/*.md')) - reached == set()


def test_the_readme_names_every_tool():
    text = (ROOT / 'README.md').read_text()
    assert [tool for tool in TOOLS if tool not in text] == []


def test_generated_pages_are_current():
    for name, make in PAGES.items():
        is_current = (ROOT / name).read_text() == make()
        assert is_current, f'{name} is not current; python -m docs.generate'


@pytest.mark.parametrize('name', SETTINGS)
def test_settings_files_have_every_parameter_at_its_default(name):
    text = (ROOT / 'config' / name).read_text()
    given = yaml.safe_load(text)['/**']['ros__parameters']
    for one in SETTINGS[name]:
        if one.default == [] or one.name == 'model_dirs':
            assert re.search(rf'^    #{one.name}: \[', text, re.M), one.name
        else:
            assert given.pop(one.name) == one.default, one.name
    assert given == {}


def float_topics():
    text = (ROOT / 'docs/diagnostics.md').read_text().replace('/BUS/', '/ttyUSB0/')
    return set(re.findall(r'`((?:vel2d|dxl)/timing/[\w/]+)`', text))


def test_layouts_plot_topics_that_exist():
    xml = ElementTree.parse(ROOT / 'config/plotjuggler.xml')
    curves = {curve.get('name') for curve in xml.iter('curve')}
    # As PlotJuggler's ROS plugins 2.1 to 2.3.1 read it.
    [ticked] = [one.get('value').split(';') for one in xml.iter('selected_topics')]
    assert {f'/{topic}/data' for topic in float_topics()} >= curves
    assert {f'{topic}/data' for topic in ticked} == curves
    foxglove = json.loads((ROOT / 'config/foxglove.json').read_text())
    panels = foxglove['configById']
    plotted = {path['value'] for panel in panels.values() for path in panel.get('paths', ())}
    assert {f'/{topic}.data' for topic in float_topics()} >= plotted
    assert set(re.findall(r'"(\w+!\w+)"', json.dumps(foxglove))) == set(panels)
    link = panels['DiagnosticStatusPanel!link']     # it stays empty without both
    assert (link['selectedHardwareId'], link['selectedName']) \
        == (known_defaults()['port'], 'vel2d_bridge: link')


@pytest.mark.parametrize(('file', 'robots'), [
    ('analyzers', {'': ''}), ('analyzers_robots', {'rover1/': 'rover1 ', 'rover2/': 'rover2 '})])
def test_analyzers_group_every_status_once(file, robots):
    groups = yaml.safe_load((ROOT / f'config/{file}.yaml').read_text())[
        'analyzers']['ros__parameters']
    analyzers = [{**one, 'path': f'{group["path"]} {one["path"]}'} for group in groups.values()
                 if isinstance(group, dict) for one in group['analyzers'].values()]

    def matching(name):         # as GenericAnalyzer does
        return [one['path'] for one in analyzers
                if any(name.startswith(start) for start in one.get('startswith', ()))
                or any(re.fullmatch(regex, name) for regex in one.get('regex', ()))]

    for name, path in (('vel2d_bridge: link', 'Link'), ('vel2d_bridge: commands', 'Commands'),
                       ('dxl_monitor: bus', 'Buses'), ('dxl_monitor: bus left', 'Buses'),
                       ('dxl_monitor: 011', 'Devices'), ('dxl_monitor: 011 knee', 'Devices'),
                       ('dxl_monitor: left/011', 'Devices'), ('dxl_monitor: bus1/011', 'Devices')):
        for robot, group in robots.items():
            [found] = matching(robot + name)
            assert found.startswith(group), name
            assert found.endswith(path), name


def policy(node):
    """Return what the SROS2 policy lets a node publish, subscribe and serve, absolute names."""
    root = ElementTree.parse(ROOT / 'config/sros2_policy.xml').getroot()
    [profile] = root.findall(f'.//profile[@node="{node}"]')

    def names(path):
        return {re.sub('^~', f'/{node}', one.text) if one.text[0] in '~/' else f'/{one.text}'
                for one in profile.findall(path)}
    return (names('topics[@publish="ALLOW"]/topic'), names('topics[@subscribe="ALLOW"]/topic'),
            names('services[@reply="ALLOW"]/service'))


@pytest.mark.parametrize('node, prefix', [('vel2d_bridge', 'vel2d'), ('dxl_monitor', 'dxl')])
def test_policy_allows_every_timing_topic(node, prefix):
    publish, _, _ = policy(node)
    timing = {f'/{topic}' for topic in float_topics() if topic.startswith(prefix)}
    assert {topic for topic in publish if '/timing/' in topic} == timing


def running(graph, node, complete):
    """Return what a node publishes, subscribes and serves, once that is `complete`."""
    def used():
        found = graph.used_by(node)
        return found if found is not None and complete(found) else None

    return wait(used)


@pytest.mark.ros
@pytest.mark.realtime(bears=0.5)
@pytest.mark.parametrize('node, link, fake, named', [
    ('vel2d_bridge', 'port', ('mecarover_fakes.fake_mcu',), ()),
    ('dxl_monitor', 'ports', ('mecarover_fakes.fake_bus',), ('-p', 'names:=ttyUSB0'))])
def test_policy_allows_what_a_running_node_uses_and_little_more(
        graph, tmp_path, node, link, fake, named):
    publish, subscribe, reply = policy(node)
    optional = {name for name in publish if '/statistics/' in name or '/cycle' in name} | {
        '/vel2d/timing/callback_to_write_ms', '/vel2d/timing/command_period_ms',
        '/vel2d/timing/stamp_age_ms', '/dxl/joint_states', '/clock'}
    with Program(*fake, '--link', str(tmp_path / 'port')), \
            Program(COMMANDS[node], '--ros-args', '-p', f'{link}:={tmp_path}/port', *named):
        used_publish, used_subscribe, used_reply = running(
            graph, node, lambda used: publish - optional <= used[0])
    assert used_publish <= publish
    assert used_subscribe | optional >= subscribe >= used_subscribe
    assert used_reply == reply


@pytest.mark.ros
@pytest.mark.realtime(bears=0.5)
@pytest.mark.parametrize('node, program', [
    ('dxl_dashboard', ('mecarover_dashboard.ros_server', '--port', '0')),
    ('mecarover_status', ('mecarover_dashboard.terminal',))])
def test_policy_allows_what_a_running_listener_uses(graph, node, program):
    publish, subscribe, reply = policy(node)
    with Program(*program):
        allowed = publish, subscribe - {'/clock'}, reply
        assert running(graph, node, lambda used: all(
            map(set.issuperset, used, allowed))) == allowed


@pytest.mark.slow
def test_pages_are_read_without_a_warning(tmp_path):
    """Every module can be described without ROS. The nightly job builds the pages."""
    try:
        import myst_parser  # noqa: F401 - the extra `docs`
    except ImportError:
        pytest.skip("skipped: no myst-parser here; pip install 'mecarover_serial[docs]'")
    cheap = [f'-D{name}' for name in (
        'autodoc_preserve_defaults=0', 'autodoc_typehints=none',
        'extensions=sphinx.ext.autodoc,myst_parser')]
    done = subprocess.run([sys.executable, '-m', 'sphinx', '-q', '-W', '--keep-going', '-b',
                           'dummy', *cheap, ROOT / 'docs', tmp_path], capture_output=True,
                          text=True, timeout=300)
    assert done.returncode == 0, done.stderr


def test_shell_scripts_parse():
    if shutil.which('bash') is None:
        pytest.skip('skipped: no bash here')
    for script in [*ROOT.glob('scripts/*'), ROOT / '.ci/run']:
        assert subprocess.run(['bash', '-n', script]).returncode == 0, script


def test_launch_files_parse_and_describe_themselves():
    for file in ROOT.glob('launch/*.launch.py'):
        assert ast.get_docstring(ast.parse(file.read_text())), file.name
