# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Tables in files: a line is a row, its columns are apart by tabs, # begins a comment."""


def rows_of(path):
    """Return the rows of a file, with as many columns as its last comment names."""
    comments, rows = [], []
    for line in path.read_text(encoding='utf-8').splitlines():
        (comments if line[0] == '#' else rows).append(line.split('\t'))
    return [row + [''] * (len(comments[-1]) - len(row)) for row in rows]
