# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""firmware/vel2d_receiver.c on this machine, with sanitizers."""
from pathlib import Path
import subprocess

from rigs.harness import REPOSITORY

FIRMWARE = REPOSITORY / 'firmware'
HERE = Path(__file__).parent
WARNINGS = ('-Wall', '-Wextra', '-Wpedantic', '-Wconversion', '-Werror')
SANITIZERS = ('-g', '-O1', '-fsanitize=address,undefined', '-fno-sanitize-recover=all')


def compiled(folder, source, *options, is_cpp=False):
    """Compile the receiver with a program that uses it."""
    program = folder / source.stem
    sources = ['-x', 'c++', source, '-x', 'c'] if is_cpp else ['-std=c99', source]
    subprocess.run(['cc', *WARNINGS, *(options or SANITIZERS), f'-I{FIRMWARE}', *sources,
                    FIRMWARE / 'vel2d_receiver.c', '-lm', '-o', program], check=True)
    return program
