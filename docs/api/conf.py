# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Sphinx: the API pages, from docstrings. Built by scripts/docs, warnings are errors."""
from pathlib import Path
import sys

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

project = 'mecarover_serial'
copyright = '2026 The mecarover_serial authors'
extensions = ['sphinx.ext.autodoc', 'sphinx.ext.viewcode']
html_theme = 'alabaster'
html_theme_options = {'fixed_sidebar': True}

# ROS is on robots, not on the machine that makes the pages.
autodoc_mock_imports = [
    'rclpy', 'rcl_interfaces', 'builtin_interfaces', 'diagnostic_msgs', 'geometry_msgs',
    'sensor_msgs', 'statistics_msgs', 'std_msgs', 'std_srvs', 'aiohttp', 'launch', 'launch_ros',
    'ament_index_python']
autodoc_default_options = {'members': True, 'member-order': 'bysource'}
autodoc_typehints = 'signature'
autodoc_preserve_defaults = True
suppress_warnings = ['ref.python']      # annotations name types that two modules have (Verdict)
PACKAGES = ('msg_defs', 'mecarover_serial', 'vel2d_bridge', 'dxl_monitor')


def as_plain_text(app, what, name, obj, options, lines):
    """Show docstrings as they are written: they are plain text, not reStructuredText."""
    if lines:
        lines[:] = ['.. plain-text::', '', *(f'   {line}' for line in lines), '']


def write_pages(app):
    """Write a page per package that lists its modules: a new module needs no entry anywhere."""
    for package in PACKAGES:
        modules = sorted('.'.join(path.relative_to(ROOT).with_suffix('').parts)
                         for path in (ROOT / package).rglob('*.py') if path.stem != '__init__')
        text = f'{package}\n{"=" * len(package)}\n\n' + ''.join(
            f'{module}\n{"-" * len(module)}\n\n.. automodule:: {module}\n\n'
            for module in modules)
        page = Path(app.srcdir) / f'{package}.rst'
        if not page.exists() or page.read_text() != text:
            page.write_text(text)


def setup(app):
    from docutils import nodes
    from docutils.parsers.rst import Directive

    class Text(Directive):
        """Paragraphs as they are, `code` in backquotes."""

        has_content = True

        def run(self):
            paragraphs = '\n'.join(self.content).split('\n\n')
            return [nodes.paragraph(text, text) for text in paragraphs]

    app.add_directive('plain-text', Text)
    app.connect('builder-inited', write_pages)
    app.connect('autodoc-process-docstring', as_plain_text)
