# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
A recording of messages: what the node publishes of the same bytes, as an MCAP file.

For Foxglove and PlotJuggler. Format and messages are those of the library rosbags, which only this
needs; it writes a folder with the file in it, so the file is there at the end.
"""
from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Sequence
from math import nan
import os
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from msg_defs.diagnostics import Joint
from msg_defs.diagnostics import metric_status
from msg_defs.diagnostics import Status
from msg_defs.diagnostics import topic_names
from msg_defs.event import Chunk
from msg_defs.nanoseconds import NS_PER_S
from servobus.errors import UsageError
from servobus.monitor import Monitor
from servobus.sources.source import Source
from servobus.status import PortState
from servobus.status import statuses_of
from servobus.status import timing_metrics

NODE = 'dxl_monitor'
REPORT_NS, TIMING_NS = NS_PER_S // 2, NS_PER_S         # as the node does
JOINTS_NS = 20_000_000
_MAGIC = b'\x89MCAP0\r\n'


class McapRecording:
    """Writes to `path` when it is closed."""

    def __init__(self, path: str, source: Source) -> None:
        try:
            from rosbags.rosbag2 import StoragePlugin
            from rosbags.rosbag2 import Writer
            from rosbags.typesys import get_typestore
            from rosbags.typesys import Stores
        except ImportError as error:
            raise UsageError(f'-w {path}: an MCAP file needs rosbags 0.10.9 or newer; '
                             'pip install -U rosbags') from error
        self._source = source
        self._path = Path(path).absolute()
        self._store = get_typestore(Stores.ROS2_JAZZY)
        self._folder = TemporaryDirectory(dir=self._path.parent)
        self._writer = Writer(Path(self._folder.name) / 'bag', version=9,
                              storage_plugin=StoragePlugin.MCAP)
        self._writer.open()
        self._topics: dict[str, Any] = {}
        self._next_report = self._next_timing = self._next_joints = 0
        self._since: dict[str, int] = {}           # up to when joints were written, by bus

    def record_chunk(self, chunk: Chunk, monitors: Mapping[str, Monitor]) -> None:
        """Write what is due at a chunk, which was fed to the monitor of its bus."""
        now, began = chunk.stamp, self._source.began
        later = began.wall - began.stamp
        if now >= self._next_report:
            self._next_report = now + REPORT_NS
            self._write_reports(now, later, monitors)
        if now >= self._next_joints:
            self._next_joints = now + JOINTS_NS
            self._write_joints(monitors, later)

    def _write_reports(self, now: int, later: int, monitors: Mapping[str, Monitor]) -> None:
        statuses, metrics = [], []
        for bus, monitor in monitors.items():
            port = PortState(self._source.wire(bus).port, '', (), bus=bus)
            report = monitor.report(now)
            label = bus if len(monitors) > 1 else ''
            statuses += statuses_of(NODE, label, report, port, True)
            metrics += timing_metrics(NODE, report, port)
        self._put_statuses('/dxl/diagnostics', statuses, now + later)
        if now >= self._next_timing:
            self._next_timing = now + TIMING_NS
            self._put_statuses('/dxl/timing', [metric_status(NODE, one) for one in metrics],
                               now + later)

    def _write_joints(self, monitors: Mapping[str, Monitor], later: int) -> None:
        parts = topic_names(list(monitors)) if len(monitors) > 1 else {}
        for bus, monitor in monitors.items():
            joints, stamp = monitor.joints(self._since.get(bus, 0))
            if joints:
                self._since[bus] = stamp
                topic = '/'.join(filter(None, ('/dxl/joint_states', parts.get(bus))))
                self._put_joints(topic, joints, stamp + later)

    def _put_statuses(self, topic: str, statuses: Sequence[Status], wall: int) -> None:
        make = self._make
        self._put(topic, 'diagnostic_msgs/msg/DiagnosticArray', wall, status=[
            make('diagnostic_msgs/msg/DiagnosticStatus', level=int(one.level), name=one.name,
                 message=one.message, hardware_id=one.hardware_id,
                 values=[make('diagnostic_msgs/msg/KeyValue', key=key, value=value)
                         for key, value in one.values]) for one in statuses])

    def _put_joints(self, topic: str, joints: Sequence[Joint], wall: int) -> None:
        columns = {name: self._column([getattr(one, name) for one in joints])
                   for name in ('position', 'velocity', 'effort')}
        self._put(topic, 'sensor_msgs/msg/JointState', wall,
                  name=[one.name for one in joints], **columns)

    @staticmethod
    def _column(values: Sequence[float | None]) -> Any:
        """Return NaN where one joint has no value, and nothing where none has."""
        import numpy
        is_empty = all(value is None for value in values)
        return numpy.array([] if is_empty else [
            nan if value is None else value for value in values], dtype=numpy.float64)

    def _put(self, topic: str, kind: str, wall: int, **fields: Any) -> None:
        wall = max(0, wall)
        sec, nanosec = divmod(wall, NS_PER_S)
        stamp = self._make('builtin_interfaces/msg/Time', sec=sec, nanosec=nanosec)
        message = self._make(
            kind, header=self._make('std_msgs/msg/Header', stamp=stamp, frame_id=''), **fields)
        if topic not in self._topics:
            self._topics[topic] = self._writer.add_connection(topic, kind, typestore=self._store)
        self._writer.write(self._topics[topic], wall, self._store.serialize_cdr(message, kind))

    def _make(self, kind: str, **fields: Any) -> Any:
        return self._store.types[kind](**fields)

    def close(self) -> None:
        self._writer.close()
        [file] = (Path(self._folder.name) / 'bag').glob('*.mcap')
        os.replace(file, self._path)
        self._folder.cleanup()


def is_mcap(begin: bytes) -> bool:
    """Tell whether a file that begins so is an MCAP file."""
    return begin.startswith(_MAGIC)
