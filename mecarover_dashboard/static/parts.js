// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// What more than one view shows: figures of timing, crumbs, and what to do meanwhile.

import {each, h, say, set} from './dom.js';
import {plural, short, splitUnit} from './format.js';

const COLUMNS = ['mean', 'p50', 'p95', 'max'];

/** What to do while nothing has come yet. */
export function fillEmpty(element, store, wanted = 'dxl/diagnostics') {
  const source = store.facts?.source;
  if (source) {
    each(element, [source], (text) => text, (text) => h('p', {class: 'empty-head'},
      `No bus traffic yet from ${text}`));
    return;
  }
  const heard = Object.values(store.topics).some(([count]) => count);
  const publishers = store.publishers[wanted] ?? 0;
  const domain = store.facts?.domain ?? '?';
  const isLooking = !publishers && !heard && store.isNew;
  const words = publishers ? `${plural(publishers, 'publisher')} of ${wanted}, but no message yet.`
    : isLooking ? `Looking for ${wanted} in ROS domain ${domain}\u2026`
      : heard ? `No message on ${wanted} yet.`
        : `There is no publisher of ${wanted} in ROS domain ${domain}.`;
  const command = wanted.startsWith('vel2d') ? 'vel2d_bridge' : 'dxl_monitor';
  each(element, [words], (text) => text, (text) => h('div', {},
    h('p', {class: 'empty-head'}, text),
    ...isLooking ? [] : [h('p', {}, 'Start the node, or play a recording:'),
      h('pre', {}, `ros2 run mecarover_serial ${command}\nros2 bag play RECORDING`)]));
}

/** Buttons of which one is chosen, [[value, content, ...], ...]; choose(value) when one is pressed. */
export const choice = (label, options, choose) =>
  h('div', {class: 'choice', role: 'group', ariaLabel: label},
    ...options.map(([value, ...content]) =>
      h('button', {'data-value': value, onclick: () => choose(value)}, ...content)));

/** Show which of the buttons made by choice() is chosen; null: none. */
export function showChosen({children}, value) {
  for (const button of children) {
    set(button, 'aria-pressed', button.dataset.value === String(value));
  }
}

/** Fill a select with [value, text]. */
export function fill(select, options, value = select.value) {
  each(select, options, ([one]) => one, ([one]) => h('option', {value: one}),
    (option, [, text]) => say(option, text));
  select.value = options.some(([one]) => one === value) ? value : options[0]?.[0];
}

/** A part of a view, below its heading (text or an element). */
export const panel = (title, ...content) =>
  h('section', {class: 'panel'}, h('h2', {}, title), ...content);

/** Links to where this view belongs, the last one being here. */
export function showCrumbs(element, links) {
  each(element, links, ([text, href]) => `${href}|${text}`,
    ([text, href]) => href ? h('a', {href}, text) : h('span', {'aria-current': 'page'}, text));
}

/** What the columns of `showMetrics` are. */
export const metricsHead = () => h('thead', {}, h('tr', {},
  ...['last 10 s', ...COLUMNS, 'max since start'].map((text) => h('th', {scope: 'col'}, text)),
  h('th', {scope: 'col'}, h('span', {class: 'unseen'}, 'unit'))));

/** A table of timing metrics; pressing a name plots it. */
export function showMetrics(body, rows, plotted, choose) {
  each(body, rows, (row) => row.metric, (row) => makeMetric(row, choose),
    (line, row) => showMetric(line, row, row.metric === plotted));
}

function makeMetric(row, choose) {
  const button = h('button', {class: 'field', onclick: () => choose(row.metric)},
    h('i', {class: 'swatch'}), h('span', {}, row.metric.replaceAll('_', ' ')));
  return h('tr', {}, h('th', {scope: 'row'}, button), ...COLUMNS.map(() => h('td')), h('td'),
    h('td', {class: 'unit'}));
}

function showMetric(line, row, isPlotted) {
  const button = line.firstChild.firstChild;
  set(button, 'aria-pressed', isPlotted);
  set(button.firstChild, 'data-line', isPlotted ? 0 : null);
  const figures = new Map(row.values.map(([key, value]) => [splitUnit(key)[0], value]));
  COLUMNS.forEach((name, at) => {
    const single = name === 'mean' ? figures.get('value') : undefined;
    say(line.children[at + 1], short(figures.get(name) ?? single ?? '', 3));
  });
  say(line.children[COLUMNS.length + 1], short(figures.get('since start max') ?? '', 3));
  say(line.lastChild, unitOf(row));
}

const unitOf = (row) => splitUnit(row.values[0]?.[0] ?? '')[1];

/** The series of a metric: p50, p95 and max of the window, or its value. */
export function seriesOf(row) {
  if (!row?.points?.length) return [];
  const names = row.points.at(-1).length > 2 ? ['p50', 'p95', 'max']
    : [row.metric.replaceAll('_', ' ')];
  return names.map((name, at) => ({name, unit: unitOf(row),
    points: row.points.map((point) => [point[0], point[at + 1] ?? null])}));
}

const hasValues = (row) => row?.points?.some((point) => point.slice(1).some(Number.isFinite));

/** The metric to plot until one is chosen: the wanted one, or else the first that has values. */
export function metricToPlot(metrics, wanted) {
  if (hasValues(metrics.get(wanted))) return wanted;
  return [...metrics.keys()].find((name) => hasValues(metrics.get(name))) ?? wanted;
}
