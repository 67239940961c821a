# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Every text that a user can meet: test/baseline/texts.txt, each marked + once it was read.

    python -m rigs.texts                    print what is new, changed or not read: exit code 1
    python -m rigs.texts --write            bring the list up to date; what is new is marked -
    python -m rigs.texts --draw 80 --seed 1 print 80 sentences, for a readers' test

A text is a string of two words or more; {name} is a value that the program fills in, only its
place counts. The words of makers in model files are not ours.
"""
import argparse
import ast
from html import unescape
from pathlib import Path
import random
import re

import yaml

ROOT = Path(__file__).resolve().parents[1]
LIST = ROOT / 'test/baseline/texts.txt'
PLACES = ('msg_defs', 'mecarover_serial', 'vel2d_bridge', 'dxl_monitor', 'mecarover_dashboard',
          'mecarover_demo', 'mecarover_fakes', 'mecarover_feed', 'launch', 'deploy', 'scripts')
WORDS = re.compile(r"[^\W\d_]{2,}[\"'”)\]},.:;%]* [\"'“({\[]*[\w-]{2,}"
                   r'|\} [^\W\d_]{3,}|[^\W\d_]{3,},? \{')
NO_TEXT = re.compile(               # patterns, queries, names of registers and keys
    r'\\[sdwSb]|\(\?|\[\^|^[\w-]+=|^(export|SELECT|PRAGMA|INSERT|UPDATE|DELETE|WITH|CREATE|BEGIN|M0)'
    r'\b|^(?:[A-Z0-9({][\w/%°)}-]* ?)+$')
JS = re.compile(
    r"""(?://[^\n]*|/\*.*?\*/|class: '[^']*')|'((?:[^'\\\n]|\\.)*)'|"((?:[^"\\\n]|\\.)*)"|"""
    r'`((?:[^`\\$]|\\.|\$\{(?:[^{}`]|`[^`]*`|\{[^}]*\})*\}|\$)*)`', re.S)
JS_VALUE = re.compile(r'\$\{((?:[^{}`]|`[^`]*`)*)\}')
QUOTED = {'text', 'also', 'says', 'source', 'name', 'expr'}     # YAML keys with words of others


def place(value):
    """Return a place for a value in a text, named after the last name in its expression."""
    return f'{{{(re.findall(r"[A-Za-z_][A-Za-z_0-9]*", value) or ["value"])[-1]}}}'


def python_texts(node):
    """Yield the strings of a module, f-strings as one: no docstrings, keys only if shown."""
    if isinstance(node, ast.Call) and ast.unparse(node.func) in ('Claim', 'pairs'):
        for one in ast.walk(node):
            for key in filter(None, one.keys if isinstance(one, ast.Dict) else ()):
                yield from python_texts(key)
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield node.value
    elif isinstance(node, ast.JoinedStr):
        yield ''.join(str(part.value) if isinstance(part, ast.Constant) else
                      place(ast.unparse(part.value)) for part in node.values)  # type: ignore
        for part in node.values:
            if isinstance(part, ast.FormattedValue):
                yield from python_texts(part.value)
    elif not (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)):
        for child in node.values if isinstance(node, ast.Dict) else ast.iter_child_nodes(node):
            yield from python_texts(child)


def module_texts(source):
    """Yield the texts of a Python file, its docstring where the program prints that."""
    if '__doc__' in source:
        yield ast.get_docstring(ast.parse(source)) or ''
    yield from python_texts(ast.parse(source))


def script_texts(source):
    """Yield the strings of a JavaScript file, those within templates too."""
    for found in JS.finditer(source):
        for inner in JS_VALUE.findall(found[3] or ''):
            yield from script_texts(inner)
        yield JS_VALUE.sub(lambda one: place(one[1]), next(filter(None, found.groups()), ''))


def yaml_texts(node):
    """Yield the strings of a YAML document, but for the words of others."""
    if isinstance(node, str):
        yield node
    elif isinstance(node, dict | list):
        for key, value in node.items() if isinstance(node, dict) else enumerate(node):
            if key not in QUOTED:
                yield from yaml_texts(value)


READERS = {
    '.py': module_texts, '.js': script_texts,
    '.html': lambda source: map(unescape, re.findall(r'(?<=[">])[^"<>]{4,}(?=["<])', source)),
    '.yaml': lambda source: yaml_texts(yaml.safe_load(source)),
    '.yml': lambda source: yaml_texts(yaml.safe_load(source)),
    '': lambda source: re.findall(r'\b(?:echo|fail|printf)\b[^"\n]*"((?:[^"\\]|\\.)*)"', source)}


def is_text(text):
    """Tell whether a string is a text, and no name, pattern or query."""
    return bool(WORDS.search(text)) and not NO_TEXT.search(text)


def all_texts():
    """Return (file, text) in the order of the files, each text once for its file."""
    files = sorted(path for name in PLACES for path in (ROOT / name).rglob('*')
                   if path.is_file() and path.suffix in READERS and path.parent.name != 'files')
    return list(dict.fromkeys(
        (str(path.relative_to(ROOT)), text) for path in files
        for text in map(' '.join, map(str.split, READERS[path.suffix](path.read_text('utf-8'))))
        if is_text(text)))


def key(file, text):
    """Return what makes a text the same: the names of the places do not count."""
    return file, re.sub(r'\{\w+\}', '{}', text)


def marks():
    """Return the marks of the list, by key."""
    found, file = {}, ''
    for line in LIST.read_text('utf-8').splitlines():
        if line[:2] in ('+ ', '- '):
            found[key(file, line[2:])] = line[0]
        else:
            file = line
    return found


def differences():
    """Return a line for each text that is new or not read, and for each that is gone."""
    known, now = marks(), {key(*one): one for one in all_texts()}
    return [f'{file}: not read: {text}' for one, (file, text) in now.items()
            if known.get(one) != '+'] + [': gone: '.join(one) for one in known.keys() - now.keys()]


def main():
    """Print differences or a draw, or write the list."""
    parser = argparse.ArgumentParser(usage=__doc__)
    parser.add_argument('--write', action='store_true')
    parser.add_argument('--draw', type=int, metavar='COUNT')
    parser.add_argument('--seed', type=int, default=1)
    options = parser.parse_args()
    texts = all_texts()
    if options.draw:
        whole = [one for one in texts if len(re.findall(r'(?<!\{)\b[a-z]+\b', one[1])) > 4]
        drawn = random.Random(options.seed).sample(whole, options.draw)
        print(*(f'{file}\n    {text}' for file, text in drawn), sep='\n')
        return 0
    if options.write:
        known, lines = marks(), ['']
        for file, text in texts:
            lines += [file] * (file not in lines) + [f'{known.get(key(file, text), "-")} {text}']
        LIST.write_text('\n'.join(lines[1:]) + '\n', 'utf-8')
    found = differences()
    print(*found, f'{len(texts)} texts, {len(found)} new, not read or gone', sep='\n')
    return bool(found)


if __name__ == '__main__':
    raise SystemExit(main())
