# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Which run a command line asks for."""
from __future__ import annotations

import argparse
from collections.abc import Sequence
from importlib.util import find_spec

from mecarover_dashboard.local_monitor import LocalMonitor
from mecarover_dashboard.recording_run import RecordingRun
from mecarover_dashboard.source_run import PortsRun
from mecarover_dashboard.source_run import ProgramRun
from mecarover_dashboard.source_run import SourceRun
from servobus.errors import UsageError
from servobus.sources.opening import is_port


def is_of_ros(parser: argparse.ArgumentParser, arguments: Sequence[str]) -> bool:
    """Tell whether a command line is about ROS topics: it names no source, and ROS is here."""
    before = arguments[:arguments.index('--')] if '--' in arguments else arguments
    try:
        return '--ros-args' in before or (
            find_spec('rclpy') is not None and not parser.parse_known_args(before)[0].source)
    except UsageError:
        return False            # it is raised again where it can be said


def make_run(tool: str, options: argparse.Namespace, command: Sequence[str],
             monitor: LocalMonitor, at_once: bool = False) -> SourceRun:
    """
    Return the run that a command line asks for; raise UsageError, PortError or OSError.

    at_once: a recording is not played but heard whole.
    """
    if command:
        return ProgramRun(tool, command, options, monitor)
    files = [name for name in options.source
             if not name.startswith('/dev/') and not is_port(name)]
    if not files:
        return PortsRun(tool, options, monitor)
    if len(options.source) > 1:
        raise UsageError(f'{files[0]}: a recording is shown alone; leave out the others')
    return RecordingRun(tool, options, monitor, at_once)
