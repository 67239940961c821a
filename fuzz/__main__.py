# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
python -m fuzz TARGET --seconds N: coverage-guided fuzzing of one target, with atheris.

Starts from test/corpus/TARGET. An input that breaks an invariant is kept, in --found or else in a
folder of its own that is told; the exit code is 1 then, and --again FILE runs it once more, with
a traceback. New inputs are kept in --found only. Needs the extra `fuzz`: pip install -e .[fuzz]
"""

import argparse
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
import pkgutil
import shutil
import subprocess
import sys
from tempfile import mkdtemp

import fuzz

CORPUS = Path(__file__).parents[1] / 'test' / 'corpus'
TARGETS = sorted(one.name for one in pkgutil.iter_modules(fuzz.__path__)
                 if one.name not in ('__main__', 'firmware', 'reference', 'script', 'volume',
                                     'whole'))
OURS = ['fuzz.script', 'msg_defs', 'dxl_monitor', 'vel2d_bridge']     # what steers the search
BROKEN = ('crash-', 'timeout-', 'oom-', 'leak-')       # how libFuzzer calls what it keeps
SEARCH = 'import sys; from fuzz.__main__ import search; search(*sys.argv[1:])'


def main():
    options = _parser().parse_args()
    if options.again:
        import_module(f'fuzz.{options.target}').check(options.again.read_bytes())
        print(f'{options.again}: nothing is broken')
        return 0
    if find_spec('atheris') is None:
        print('fuzz: atheris is not installed; pip install -e .[fuzz]', file=sys.stderr)
        return 1
    found = options.found or Path(mkdtemp(prefix=f'fuzz_{options.target}_'))
    found.mkdir(parents=True, exist_ok=True)
    before = set(found.iterdir())
    # A process of its own: libFuzzer ends the one it runs in.
    code = subprocess.run([sys.executable, '-c', SEARCH, options.target, str(found),
                           f'-max_total_time={options.seconds}',
                           f'-seed={options.seed}'], check=False).returncode
    broken = sorted(file for file in set(found.iterdir()) - before if file.name.startswith(BROKEN))
    for file in broken:
        print(f'fuzz: {file} breaks {options.target}; again: '
              f'python -m fuzz {options.target} --again {file}')
    if not options.found and not broken:
        shutil.rmtree(found)
    return int(bool(code or broken))


def search(target, found, *options):
    """Fuzz until libFuzzer ends this process."""
    import atheris
    with atheris.instrument_imports(include=OURS):
        check = import_module(f'fuzz.{target}').check
    atheris.Setup(['fuzz', '-max_len=1024', '-timeout=30', '-print_final_stats=1', *options,
                   f'-artifact_prefix={found}/', found, str(CORPUS / target)], check)
    atheris.Fuzz()


def _parser():
    parser = argparse.ArgumentParser(prog='python -m fuzz', description=(
        'Fuzz one target guided by coverage; what must hold is in its check().'))
    add = parser.add_argument
    add('target', choices=TARGETS)
    add('--seconds', type=int, default=60, help='how long (default %(default)s)')
    add('--seed', type=int, default=1, help='(default %(default)s)')
    add('--found', type=Path, metavar='FOLDER', help='keep new inputs and broken ones here')
    add('--again', type=Path, metavar='FILE', help='check this input only, and show what breaks')
    return parser


if __name__ == '__main__':
    sys.exit(main())
