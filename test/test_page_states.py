# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
One cause, six ways to see it: page, tab, screen reader, /metrics, alert, terminal.

PAGE_STATES=FOLDER keeps a picture of each.
"""
import os
from pathlib import Path
import re

import dashboard_page
from dashboard_page import Dashboard
from dashboard_page import SIZES
from page_states import alerts
from page_states import Clock
from page_states import places
from page_states import repeated
from page_states import Robot
from page_states import rows
from page_states import Stage
import pytest

from msg_defs.diagnostics import Level

WHY_NOT = dashboard_page.why_not()
pytestmark = [pytest.mark.realtime(bears=0.5),
              pytest.mark.skipif(bool(WHY_NOT), reason=WHY_NOT or 'runs')]
MARKS = {Level.OK: '', Level.WARN: '\u25b2 ', Level.ERROR: '\u2716 ', Level.STALE: '\\? '}
WORDS = {Level.OK: 'ok', Level.WARN: 'WARN', Level.ERROR: 'ERROR', Level.STALE: 'silent'}
WELL = """() => {
    const states = [...document.querySelectorAll('main .bar, main .robot')]
        .map((one) => one.dataset.state);
    return states.length > 0 && states.every((one) => one === 'ok');
}"""
# What the eye finds first: the uppermost bar or card that is seen.
FIRST = """() => {
    const bars = [...document.querySelectorAll('main .bar, main .robot')]
        .filter((one) => one.checkVisibility())
        .sort((a, b) => a.getBoundingClientRect().top - b.getBoundingClientRect().top
            || a.getBoundingClientRect().left - b.getBoundingClientRect().left);
    return {text: bars[0]?.innerText ?? '', bright: getComputedStyle(bars[0]).backgroundColor,
        bottom: bars[0]?.getBoundingClientRect().bottom,
        known: bars[0]?.dataset.known !== 'false', all: document.querySelector('main').innerText,
        title: document.title,
        said: document.getElementById('said').textContent,
        live: document.querySelector('#live span').textContent};
}"""


def look(page, row, stage):
    """Return what each of the six says, by name, once the page shows the row."""
    seen = {}

    def is_shown():
        seen.update(page.evaluate(FIRST))
        return re.search(row.bar, seen['text'].replace('\n', ' ')) \
            and (not row.mark or re.search(row.mark, seen['title']))
    try:
        stage.wait_for(row.robots, is_shown)
    except AssertionError:
        raise AssertionError(f'{row.cause}: {seen}') from None
    problems = stage.problems()
    return seen | {'metrics': problems, 'alerts': alerts(problems), 'terminal': stage.terminal()}


@pytest.mark.parametrize(('of', 'healthy'), [
    ('one robot', [Robot()]), ('two robots', [Robot('rover1'), Robot('rover2')])])
def test_all_six_say_the_same(of, healthy, monkeypatch):
    folder = os.environ.get('PAGE_STATES')
    clock = Clock(monkeypatch)
    with dashboard_page.browser() as chromium, Dashboard() as dashboard:
        stage = Stage(dashboard, clock)
        stage.play(healthy)
        width, height = SIZES['phone']
        page = chromium.new_page(viewport={'width': width, 'height': height})
        page.goto(dashboard.address)
        twice = []
        for at, row in enumerate(rows(of)):
            stage.play(healthy)
            stage.wait_for(healthy, lambda: page.evaluate(WELL))
            stage.play(row.robots)
            seen = look(page, row, stage)
            check(row, seen, height)
            if row.remedy:
                page.get_by_role('link', name=f'What to do: {row.remedy}').click()
                page.get_by_role('heading', name=row.remedy).wait_for()
            if folder:
                page.screenshot(path=Path(folder) / f'{of}-{at:02}.png')
            for place in places(row.robots):
                stage.go_on(row.robots)
                twice += [(row.cause, place, text) for text in repeated(page, place)]
                if (len(row.robots) > 1) is (place == '#/'):       # else a bar says it
                    headline = page.locator('#headline')
                    assert headline.is_visible() is bool(row.mark), (row.cause, place)
                    assert re.search(row.mark, headline.inner_text()), (row.cause, place)
        dashboard.stop()
        page.locator('#banner').wait_for()
        twice += [('no connection', place, text) for place in ('#/log', '#/bridge', '#/')
                  for text in repeated(page, place)]
        assert not twice, '\n'.join(map(str, twice))


def check(row, seen, height):
    level = Level(row.level)
    assert re.search(f'^{MARKS[level]}.*{row.mark}', seen['title']), (row.cause, seen)
    assert seen['bottom'] < height, (row.cause, seen)
    assert re.search(row.count, seen['text']), (row.cause, seen)
    is_known = 'report' not in row.problem and 'closed' not in row.problem
    assert seen['known'] is is_known, (row.cause, seen)
    if '?' in row.count and len(row.robots) == 1:        # its rates would be old
        assert 'packets/s' not in seen['all'], row.cause
    assert (seen['live'] == 'live') is is_known or len(row.robots) > 1, (row.cause, seen)
    first = seen['terminal'][level is Level.OK]          # well: the bridge comes before the bus
    assert re.search(f'^{WORDS[level]} .*{row.headline}', first), (row.cause, seen)
    if level is Level.OK:
        assert (seen['metrics'], seen['alerts']) == ({}, []), row.cause
        return
    assert re.search(row.headline, seen['said']), (row.cause, seen)
    found = [labels for labels, value in seen['metrics'].items() if value == row.level]
    assert any(f'problem="{row.problem}"' in labels for labels in found), (row.cause, seen)
    is_alert = any(re.match(rf'rover\.local:8420( rover\d)?: (bridge|bus): {row.problem}$', one)
                   for one in seen['alerts'])
    assert is_alert is (level is not Level.WARN), (row.cause, seen)
