# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Every text that a user can meet: test/baseline/texts.txt, each marked + once it was read.

    python -m rigs.texts                    print what is new, changed or not read: exit code 1
    python -m rigs.texts --write            bring the list up to date; what is new is marked -
    python -m rigs.texts --draw 80 --seed 1 print 80 of all texts, for a readers' test

A text is a string of at least two words in the product, launch/, deploy/ and scripts/, an item of
a YAML file or a label of the web page. {name} is a value that the program fills in; only its place
counts. A docstring counts where a program prints it.
"""
import argparse
import ast
from collections.abc import Iterator
from html import unescape
from pathlib import Path
import random
import re

import yaml

ROOT = Path(__file__).resolve().parents[1]
LIST = ROOT / 'test/baseline/texts.txt'
PLACES = ('msg_defs', 'mecarover_serial', 'vel2d_bridge', 'dxl_monitor', 'mecarover_dashboard',
          'mecarover_demo', 'launch', 'deploy', 'scripts')
WORDS = re.compile(r"[^\W\d_]{2,}[\"'”)\]},.:;%]* [\"'“({\[]*[\w-]{2,}"
                   r'|\} [^\W\d_]{3,}|[^\W\d_]{3,},? \{')
NO_TEXT = re.compile(               # patterns, SQL, names of registers and keys
    r'\\[sdwSb]|\(\?|\[\^|^[\w-]+=|^(SELECT|PRAGMA|INSERT|UPDATE|DELETE|WITH|CREATE|BEGIN|M0)\b'
    r'|^(?:[A-Z0-9({][\w/%°)}-]* ?)+$')
JS = re.compile(
    r"""(?://[^\n]*|/\*.*?\*/|class: '[^']*')|'((?:[^'\\\n]|\\.)*)'|"((?:[^"\\\n]|\\.)*)"|"""
    r'`((?:[^`\\$]|\\.|\$\{(?:[^{}`]|`[^`]*`|\{[^}]*\})*\}|\$)*)`', re.S)
HTML = re.compile(r'(?:aria-label|title|placeholder|content)="([^"]+)"|>([^<>]+)<')
SHELL = re.compile(r'\b(?:echo|fail|printf)\b[^"\n]*"((?:[^"\\]|\\.)*)"')
QUOTED = {'text', 'also', 'says', 'source', 'name', 'expr'}     # YAML keys with words of others
Texts = list[tuple[str, str]]                                   # (file, text)


def place(value: str) -> str:
    """Return a place for a value in a text, named after the last name in its expression."""
    name = (re.findall(r'[A-Za-z_]\w*', value) or ['value'])[-1]
    return f'{{{name}}}'


def joined(node: ast.JoinedStr) -> str:
    """Return an f-string as one text."""
    return ''.join(part.value if isinstance(part, ast.Constant) else place(ast.unparse(part.value))
                   for part in node.values)


def python_texts(node: ast.AST, prints_doc: bool = True) -> Iterator[str]:
    """Yield the strings of a module: no docstrings, keys of dicts, patterns."""
    match node:
        case ast.Constant(value=str(text)):
            yield text
        case ast.JoinedStr():
            yield joined(node)
            for part in node.values:
                if isinstance(part, ast.FormattedValue):
                    yield from python_texts(part.value)
        case ast.Expr(value=ast.Constant()):
            pass
        case ast.Dict():
            for value in node.values:
                yield from python_texts(value)
        case _:
            for child in ast.iter_child_nodes(node):
                yield from python_texts(child)


def module_texts(source: str) -> Iterator[str]:
    """Yield the texts of a Python file, its docstring where the program prints that."""
    if '__doc__' in source:
        yield ast.get_docstring(ast.parse(source)) or ''
    yield from python_texts(ast.parse(source))


def script_texts(source: str) -> Iterator[str]:
    """Yield the strings of a JavaScript file; what has one word only if it is a label."""
    for found in JS.finditer(source):
        text = next(filter(None, found.groups()), '')
        if found[3]:
            for inner in re.findall(r'\$\{((?:[^{}`]|`[^`]*`)*)\}', text):
                yield from script_texts(inner)
            text = re.sub(r'\$\{((?:[^{}`]|`[^`]*`)*)\}', lambda one: place(one[1]), text)
        yield f'{text} (label)' if re.fullmatch('[A-Z][a-z]{2,}', text) else text


def yaml_texts(node: object) -> Iterator[str]:
    """Yield the strings of a YAML document, but for the words of others."""
    match node:
        case str():
            yield node
        case dict():
            for key, value in node.items():
                if key not in QUOTED:
                    yield from yaml_texts(value)
        case list():
            for value in node:
                yield from yaml_texts(value)


def texts_in(path: Path) -> Iterator[str]:
    """Yield the texts of one file."""
    source = path.read_text(encoding='utf-8')
    match path.suffix:
        case '.py':
            found = module_texts(source)
        case '.js':
            found = script_texts(source)
        case '.html':
            found = (unescape(one[1] or one[2]) for one in HTML.finditer(source))
        case '.yaml' | '.yml':
            found = yaml_texts(yaml.safe_load(source))
        case '':
            found = (one[1] for one in SHELL.finditer(source))
        case _:
            return
    for text in found:
        text = ' '.join(text.split())
        if WORDS.search(text) and not NO_TEXT.search(text):
            yield text


def all_texts() -> Texts:
    """Return all texts in the order of the files, each once for its file."""
    files = sorted(path for name in PLACES for path in (ROOT / name).rglob('*') if path.is_file())
    return list(dict.fromkeys((str(path.relative_to(ROOT)), text)
                              for path in files for text in texts_in(path)))


def key(file: str, text: str) -> tuple[str, str]:
    """Return what makes a text the same: the names of the places do not count."""
    return file, re.sub(r'\{\w+\}', '{}', text)


def read() -> dict[tuple[str, str], str]:
    """Return the marks of the list, by key."""
    marks, file = {}, ''
    for line in LIST.read_text(encoding='utf-8').splitlines() if LIST.exists() else ():
        if line[:2] in ('+ ', '- '):
            marks[key(file, line[2:])] = line[0]
        else:
            file = line
    return marks


def differences() -> list[str]:
    """Return a line for each text that is new or not read, and for each that is gone."""
    marks, now = read(), {key(*one): one for one in all_texts()}
    return [f'{file}: not read: {text}' for one, (file, text) in now.items()
            if marks.get(one) != '+'] + [f'{file}: gone: {text}'
                                         for file, text in marks.keys() - now.keys()]


def write() -> None:
    """Bring the list up to date; what is in it already keeps its mark."""
    marks, lines, last = read(), [], ''
    for file, text in all_texts():
        lines += [file] * (file != last) + [f'{marks.get(key(file, text), "-")} {text}']
        last = file
    LIST.write_text('\n'.join(lines) + '\n', encoding='utf-8')


def main() -> int:
    """Print differences or a draw, or write the list."""
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--write', action='store_true')
    parser.add_argument('--draw', type=int, metavar='COUNT')
    parser.add_argument('--seed', type=int, default=1)
    options = parser.parse_args()
    if options.draw:
        for file, text in random.Random(options.seed).sample(all_texts(), options.draw):
            print(f'{file}\n    {text}')
        return 0
    if options.write:
        write()
    found = differences()
    print(*found, f'{len(all_texts())} texts, {len(found)} new, not read or gone', sep='\n')
    return bool(found)


if __name__ == '__main__':
    raise SystemExit(main())
