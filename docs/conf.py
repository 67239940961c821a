# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Sphinx, for scripts/docs and for rosdoc2 (docs.ros.org): README, the pages, the docstrings."""
from pathlib import Path
import re
import sys
from xml.etree import ElementTree

# rosdoc2 copies this folder and runs this file from a conf.py of its own, which names it.
ITS_OWN = re.search(r'open\("(.+/docs/conf\.py)"\)', Path(__file__).read_text())
ROOT = Path(ITS_OWN[1] if ITS_OWN else __file__).resolve().parents[1]
REPOSITORY = ElementTree.parse(ROOT / 'package.xml').findtext('url[@type="repository"]')

project = 'mecarover_serial'
copyright = '2026 The mecarover_serial authors'
extensions = ['sphinx.ext.autodoc', 'sphinx.ext.viewcode', 'myst_parser']
myst_heading_anchors = 3
html_theme = 'alabaster'
# What rosdoc2 adds: README without its pictures, and mecarover_serial/ once more.
exclude_patterns = ['index.rst', '__readme_include.rst', 'standard*', 'modules.rst',
                    'mecarover_serial*']

# ROS is on robots, not on the machine that makes the pages.
autodoc_mock_imports = [
    'rclpy', 'rcl_interfaces', 'builtin_interfaces', 'diagnostic_msgs', 'geometry_msgs',
    'sensor_msgs', 'statistics_msgs', 'std_msgs', 'std_srvs', 'aiohttp', 'launch', 'launch_ros',
    'ament_index_python']
autodoc_default_options = {'members': True, 'member-order': 'bysource'}
autodoc_typehints = 'description'      # a list of the parameters, each with its type
autodoc_preserve_defaults = True
suppress_warnings = ['ref.python']      # annotations name types that two modules have (Verdict)


def as_plain_text(app, what, name, obj, options, lines):
    """Show docstrings as they are written: they are plain text, not reStructuredText."""
    if lines and lines[0].startswith('Alias for field number'):
        lines[:] = []               # Python says that of each field, and its class what it means
    if lines:
        lines[:] = ['.. plain-text::', '', *(f'   {line}' for line in lines), '']


def complete(app, page, content):
    """Put README in front of the list of pages, and a package's modules on its page."""
    if page == 'index':
        readme = (ROOT / 'README.md').read_text('utf-8')
        content[0] = re.sub(r'\]\((?!http|#)', '](../', readme).replace('](../docs/', '](') \
            + content[0]
    elif page.startswith('api/') and page != 'api/index':
        modules = sorted('.'.join(path.relative_to(ROOT).with_suffix('').parts)
                         for path in (ROOT / page[4:]).rglob('*.py') if path.stem != '__init__')
        content[0] += ''.join(f'\n{module}\n{"-" * len(module)}\n\n.. automodule:: {module}\n'
                              for module in modules)
    # What is no page is in the repository.
    content[0] = content[0].replace('](../', f']({REPOSITORY}/blob/main/')


def setup(app):
    from docutils import nodes
    from docutils.parsers.rst import Directive

    class Text(Directive):
        """Paragraphs as they are, `code` in backquotes."""

        has_content = True

        def run(self):
            paragraphs = '\n'.join(self.content).split('\n\n')
            return [nodes.paragraph(text, text) for text in paragraphs]

    sys.path.insert(0, str(ROOT))       # only now: rosdoc2 must not take launch/ for ROS's own
    app.add_directive('plain-text', Text)
    app.connect('source-read', complete)
    app.connect('autodoc-process-docstring', as_plain_text)
