# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Plays random programs with each mistake; prints how often the doctor is right, by kind.

    scripts/python -m fuzz.programs                   20 programs of each kind and family
    scripts/python -m fuzz.programs --cases 200 --seed 7 --stutter 2
    scripts/python -m fuzz.programs --only loose --show       what was found in each case
    scripts/python -m fuzz.programs --write           keep the scores that test_programs.py holds
"""
import argparse
from collections import Counter
import sys

from fuzz.programs.play import FAMILIES
from fuzz.programs.play import kinds
from fuzz.programs.play import play
from fuzz.programs.play import SCORES
from fuzz.programs.play import SEEDS


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--cases', type=int, default=20)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--stutter', type=float, default=0.0, help='stops of the machine a second')
    parser.add_argument('--only', default='', help='a part of the name of the kinds')
    parser.add_argument('--family', choices=FAMILIES)
    parser.add_argument('--show', action='store_true')
    parser.add_argument('--write', action='store_true')
    given = parser.parse_args(arguments)
    if given.write:
        SCORES.write_text(''.join(
            f'{kind}\t{family}\t{" ".join(play(kind, family, seed).score for seed in SEEDS)}\n'
            for kind, family in kinds()))
        return 0
    total = Counter()
    for kind, family in kinds():
        if given.only not in kind or given.family not in (None, family):
            continue
        score, wrong = Counter(), Counter()
        for seed in range(given.seed, given.seed + given.cases):
            result = play(kind, family, seed, given.stutter)
            score[result.score] += 1
            wrong.update(result.wrong)
            if given.show:
                print(seed, result.score, *result.wrong, sep=' ')
                print(*(f'    {one}' for one in (*result.texts, *result.unsure)), sep='\n')
        total += score
        print(f'{kind:42} {family:8} {spelt(score)}   {spelt(wrong)}', flush=True)
    print(f'{"all":51} {spelt(total)}')
    return 0


def spelt(counts):
    return ', '.join(f'{name} {count}' for name, count in sorted(counts.items()))


if __name__ == '__main__':
    sys.exit(main())
