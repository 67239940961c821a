// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// What more than one view shows: findings, figures of timing, crumbs, and what to do meanwhile.

import {each, h, icon, say, set} from './dom.js';
import {path, plural, short, splitUnit} from './format.js';
import {deviceName} from './store.js';

const COLUMNS = ['mean', 'p50', 'p95', 'max'];

/** What to do while nothing has come yet. */
export function fillEmpty(element, store, wanted = 'dxl/diagnostics') {
  const heard = Object.values(store.topics).some(([count]) => count);
  const publishers = store.publishers[wanted] ?? 0;
  const words = publishers
    ? `${plural(publishers, 'publisher')} of ${wanted}, no message yet.`
    : heard ? `Nothing on ${wanted} yet.` : `Nobody publishes ${wanted} in ROS domain ${store.facts?.domain ?? '?'}.`;
  const command = wanted.startsWith('vel2d') ? 'vel2d_bridge' : 'dxl_monitor';
  each(element, [words], (text) => text, (text) => h('div', {},
    h('p', {class: 'empty-head'}, text),
    h('p', {}, 'Start the node, or play a recording:'),
    h('pre', {}, `ros2 run mecarover_serial ${command}\nros2 bag play RECORDING`)));
}

/** Links to where this view belongs, the last one being here. */
export function showCrumbs(element, links) {
  each(element, links, ([text, href]) => `${href}|${text}`,
    ([text, href]) => href ? h('a', {href}, text) : h('span', {'aria-current': 'page'}, text));
}

/** One finding of the doctor in its item: icon, rule, message. */
export function showFinding(item, [rule, message]) {
  say(item.children[1], rule.replaceAll('_', ' '));
  say(item.children[2], message);
}

/** List the findings of buses and their devices; return how many. */
export function showFindings(element, groups) {
  const found = groups.flatMap(({row, devices}) => [
    ...(row?.findings ?? []).map(([rule, text]) => [rule, text, null, row.name]),
    ...devices.flatMap((device) => device.findings.map(([rule, text]) => [rule, text, device, device.name]))]);
  each(element, found, ([rule, , , of]) => `${rule}|${of}`, makeFinding, showFinding);
  return found.length;
}

const makeFinding = ([, , device]) => h('li', {}, icon('warn'), h('b'), h('span'),
  device ? h('a', {href: path('device', device.name)}, deviceName(device)) : null);

/** What the columns of `showMetrics` are. */
export const metricsHead = () => h('thead', {}, h('tr', {}, ...['last 10 s', ...COLUMNS, 'max ever'].map((text) => h('th', {scope: 'col'}, text)),
  h('th', {scope: 'col'}, h('span', {class: 'unseen'}, 'unit'))));

/** A table of timing metrics; pressing a name plots it. */
export function showMetrics(body, rows, plotted, choose) {
  each(body, rows, (row) => row.metric, (row) => h('tr', {}, h('th', {scope: 'row'}, h('button', {type: 'button', class: 'field', onclick: () => choose(row.metric)}, h('i', {class: 'swatch'}), h('span', {}, row.metric.replaceAll('_', ' ')))),
    ...COLUMNS.map(() => h('td')), h('td'), h('td', {class: 'unit'})), (line, row) => {
    set(line.firstChild.firstChild, 'aria-pressed', row.metric === plotted);
    set(line.firstChild.firstChild.firstChild, 'data-line', row.metric === plotted ? 0 : null);
    const figures = new Map(row.values.map(([key, value]) => [splitUnit(key)[0], value]));
    COLUMNS.forEach((name, at) => say(line.children[at + 1], short(figures.get(name) ?? (name === 'mean' ? figures.get('value') : undefined) ?? '', 3)));
    say(line.children[COLUMNS.length + 1], short(figures.get('since start max') ?? '', 3));
    say(line.lastChild, unitOf(row));
  });
}

const unitOf = (row) => splitUnit(row.values[0]?.[0] ?? '')[1];

/** The series of a metric: p50, p95 and max of the window, or its value. */
export function seriesOf(row) {
  if (!row?.points?.length) return [];
  const names = row.points.at(-1).length > 2 ? ['p50', 'p95', 'max'] : [row.metric.replaceAll('_', ' ')];
  return names.map((name, at) => ({name, unit: unitOf(row), points: row.points.map((point) => [point[0], point[at + 1] ?? null])}));
}

