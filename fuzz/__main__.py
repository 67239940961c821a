# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
python -m fuzz TARGET --seconds N: coverage-guided fuzzing of one target, with atheris.

Starts from test/corpus/TARGET; new inputs go to --found (default: a folder that is deleted), a
crash is written there and the exit code is not 0. Needs the extra `fuzz`: pip install -e .[fuzz]
"""

import argparse
from importlib import import_module
from pathlib import Path
import pkgutil
import sys
from tempfile import TemporaryDirectory

import fuzz

CORPUS = Path(__file__).parents[1] / 'test' / 'corpus'
TARGETS = sorted(one.name for one in pkgutil.iter_modules(fuzz.__path__)
                 if one.name not in ('__main__', 'script', 'volume'))
OURS = ['fuzz', 'msg_defs', 'dxl_monitor', 'vel2d_bridge']


def main():
    options = _parser().parse_args()
    try:
        import atheris
    except ImportError:
        print('fuzz: atheris is not installed; pip install -e .[fuzz]', file=sys.stderr)
        return 1
    with atheris.instrument_imports(include=OURS):
        check = import_module(f'fuzz.{options.target}').check
    corpus = CORPUS / options.target
    corpus.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory() as folder:
        found = options.found or Path(folder)
        found.mkdir(parents=True, exist_ok=True)
        atheris.Setup(['fuzz', f'-max_total_time={options.seconds}', '-max_len=1024',
                       '-timeout=30', f'-seed={options.seed}', '-print_final_stats=1',
                       f'-artifact_prefix={found}/', str(found), str(corpus)], check)
        atheris.Fuzz()
    return 0


def _parser():
    parser = argparse.ArgumentParser(prog='python -m fuzz', description=(
        'Fuzz one target guided by coverage; what must hold is in its check().'))
    add = parser.add_argument
    add('target', choices=TARGETS)
    add('--seconds', type=int, default=60, help='how long (default %(default)s)')
    add('--seed', type=int, default=1, help='(default %(default)s)')
    add('--found', type=Path, metavar='FOLDER', help='keep new inputs here')
    return parser


if __name__ == '__main__':
    sys.exit(main())
