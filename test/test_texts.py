# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Every text that a user can meet was read: test/baseline/texts.txt has a mark for each."""
from rigs import texts


def test_every_text_was_read():
    found = texts.differences()
    assert found == [], 'python -m rigs.texts --write, then read each line with -, and mark it +'


def test_a_new_text_is_seen():
    source = '''"""A docstring."""
help = 'a text of several words'
said = {'a key of a dict': f'{port.name}: not open ({error!r}); {len(ports)} ports'}
names = ['word', 'Present Position', 'SELECT name FROM sources']
'''
    assert [one for one in texts.module_texts(source) if texts.is_text(one)] == [
        'a text of several words', '{name}: not open ({error}); {ports} ports']
    assert list(filter(texts.is_text, texts.script_texts(
        "// 'no text here'\nsay(`${count} of ${all.length}: ${why ? 'it is old' : 'Lost'}`)"))) \
        == [
        'it is old', '{count} of {length}: {Lost}']
