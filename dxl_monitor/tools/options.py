# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What the doctor says, in the words of a command line: its rules name the parameters of the node.

A remedy must name what a person types here.
"""

from __future__ import annotations

from dxl_monitor.bus.report import BusReport

_OPTIONS = {'`bauds`': '-b', '`devices`': '--devices'}


def for_tools(text: str) -> str:
    """Return a message with the options of the tools in place of the node's parameters."""
    for parameter, option in _OPTIONS.items():
        text = text.replace(parameter, option)
    return text


def report_for_tools(report: BusReport) -> BusReport:
    """Return a report whose messages name the options of the tools."""
    return report._replace(
        message=for_tools(report.message),
        devices=tuple(one._replace(message=for_tools(one.message)) for one in report.devices),
        findings=tuple(one._replace(message=for_tools(one.message)) for one in report.findings),
        doubts=tuple(one._replace(message=for_tools(one.message)) for one in report.doubts))
