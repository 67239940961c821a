# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Tables of docs/benchmarks.md that a command writes: between two marks, nothing else changes."""

from pathlib import Path

from benchmark.harness import REPOSITORY
from mecarover_serial.cli import UsageError

PAGE = REPOSITORY / 'docs' / 'benchmarks.md'


def marks(section: str) -> tuple[str, str]:
    """Return the lines around the table of a section."""
    return f'<!-- scripts/bench --only {section} --write -->\n', '<!-- until here -->\n'


def with_table(text: str, section: str, table: str) -> str:
    """Return the page with this table (Markdown) in the place of the one it has."""
    begin, end = marks(section)
    before, mark, rest = text.partition(begin)
    _, until, after = rest.partition(end)
    if not (mark and until):
        raise UsageError(f'{PAGE.name}: it has no place for {section}; put a line '
                         f'{begin.strip()} and below it {end.strip()}')
    return f'{before}{begin}\n{table}\n{end}{after}'


def write(section: str, table: str, page: Path = PAGE) -> None:
    page.write_text(with_table(page.read_text(encoding='utf-8'), section, table),
                    encoding='utf-8')
