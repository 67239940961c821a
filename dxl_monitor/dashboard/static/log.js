// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// View 4: the figures of the thesis per bus, its load, a plot of any of them, findings, errors.

import {showFinding} from './device.js';
import {each, h, icon, say, set, setIcon} from './dom.js';
import {numberOf, path, short, splitUnit} from './format.js';
import {fillEmpty} from './overview.js';
import {Plot} from './plot.js';
import {deviceName, stateOf, valueOf} from './store.js';

const COLUMNS = ['mean', 'p50', 'p95', 'max'];
const THESIS = ['time_per_buffer', 'time_between_buffers', 'bytes_per_buffer', 'bus_load', 'byte_rate', 'packet_rate', 'error_rate'];

export class LogView {
  constructor([bus]) {
    this.bus = bus;
    this.title = 'Log and timing';
    this.metric = 'bus_load';
    this.plot = new Plot('Timing', 300);
    this.choice = h('nav', {class: 'choice', ariaLabel: 'Bus'});
    this.empty = h('div', {class: 'empty'});
    this.load = h('div', {class: 'gauge', role: 'meter', ariaLabel: 'Bus load', 'aria-valuemin': 0, 'aria-valuemax': 100}, h('b'), h('span', {class: 'gauge-bar'}, h('i')), h('span', {class: 'quiet'}, 'bus load'));
    this.rows = h('tbody');
    this.counters = h('tbody');
    this.findings = h('ul', {class: 'findings'});
    this.doubts = h('ul', {class: 'findings doubts'});
    this.untold = h('details', {}, h('summary', {class: 'quiet'}), this.doubts);
    this.errors = h('ol', {class: 'errors'});
    this.status = h('p', {class: 'message'}, icon('ok'), h('span'));
    this.noFindings = h('p', {class: 'quiet'}, 'Nothing found.');
    this.noErrors = h('p', {class: 'quiet'}, 'No errors.');
    this.body = h('div', {class: 'columns'},
      h('div', {},
        h('section', {class: 'panel'}, h('h2', {}, 'Timing'), this.load,
          h('table', {class: 'figures'}, h('caption', {class: 'unseen'}, 'Timing over the last 10 s'),
            h('thead', {}, h('tr', {}, ...['last 10 s', ...COLUMNS, 'max ever', ''].map((text) => h('th', {scope: 'col'}, text || h('span', {class: 'unseen'}, 'unit'))))), this.rows)),
        h('section', {class: 'panel'}, h('h2', {}, 'Findings'), this.noFindings, this.findings, this.untold)),
      h('div', {},
        h('section', {class: 'panel', ariaLabel: 'Plot'}, this.plot.element),
        h('section', {class: 'panel'}, h('h2', {}, 'Last errors'), this.noErrors, this.errors),
        h('section', {class: 'panel'}, h('h2', {}, 'Bus'), this.status, h('table', {class: 'fields facts'}, h('caption', {class: 'unseen'}, 'Counters of the bus'), this.counters))));
    this.element = h('div', {}, h('div', {class: 'head'}, h('h1', {tabindex: -1}, this.title), this.choice), this.empty, this.body);
  }

  close() { this.plot.close(); }

  update(store) {
    const groups = store.groups();
    this.empty.hidden = groups.length > 0;
    this.body.hidden = !groups.length;
    if (!groups.length) {
      fillEmpty(this.empty, store);
      return;
    }
    const group = groups.find((one) => one.key === this.bus) ?? groups[0];
    this.choice.hidden = groups.length < 2;
    each(this.choice, groups, (one) => one.key, (one) => h('a', {href: path('log', one.key)}, icon('ok'), h('span')), (link, one) => {
      say(link.lastChild, one.label);
      set(link, 'data-state', one.state);
      setIcon(link.firstChild, one.state);
      set(link, 'aria-current', one === group ? 'page' : null);
    });
    this.#timing(store, group);
    this.#bus(group);
  }

  #timing(store, group) {
    const metrics = store.metrics(group.node, group.bus);
    const own = store.metrics(group.node, '');
    if (own.has('resident_memory')) metrics.set('resident_memory', own.get('resident_memory'));
    const load = numberOf(valueOf(metrics.get('bus_load'), 'value (%)') ?? '');
    this.load.hidden = !Number.isFinite(load);
    say(this.load.firstChild, `${short(String(load), 3)} %`);
    set(this.load, 'aria-valuenow', Math.round(load));
    this.load.children[1].firstChild.style.width = `${Math.min(100, load)}%`;
    set(this.load, 'data-state', load > 90 ? 'warn' : 'ok');
    const names = [...THESIS.filter((name) => metrics.has(name)), ...[...metrics.keys()].filter((name) => !THESIS.includes(name))];
    showMetrics(this.rows, names.map((name) => metrics.get(name)), this.metric, (name) => { this.metric = name; this.update(store); });
    this.plot.label = this.metric.replaceAll('_', ' ');
    this.plot.update(seriesOf(metrics.get(this.metric)), store.now());
  }

  #bus(group) {
    const {row} = group;
    const state = stateOf(row);
    set(this.status, 'data-state', state);
    setIcon(this.status.firstChild, state);
    say(this.status.lastChild, row?.message ?? 'no status of the bus yet');
    this.noFindings.hidden = showFindings(this.findings, [group]) > 0;
    const doubts = row?.doubts ?? [];
    this.untold.hidden = !doubts.length;
    say(this.untold.firstChild, `${doubts.length} cannot be told yet`);
    each(this.doubts, doubts, ([rule]) => rule, () => h('li', {}, icon('stale'), h('b'), h('span')), showFinding);
    const errors = row?.errors ?? [];
    this.noErrors.hidden = errors.length > 0;
    each(this.errors, errors, (line) => line, (line) => h('li', {}, line));
    each(this.counters, row?.values ?? [], ([key]) => key, ([key]) => h('tr', {}, h('th', {scope: 'row'}, splitUnit(key)[0]), h('td', {class: 'value'}), h('td', {class: 'unit'}, splitUnit(key)[1])),
      (line, [, value]) => say(line.children[1], value));
  }
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

export const unitOf = (row) => splitUnit(row.values[0]?.[0] ?? '')[1];

/** The series of a metric: p50, p95 and max of the window, or its value. */
export function seriesOf(row) {
  if (!row?.points?.length) return [];
  const names = row.points.at(-1).length > 2 ? ['p50', 'p95', 'max'] : [row.metric.replaceAll('_', ' ')];
  return names.map((name, at) => ({name, unit: unitOf(row), points: row.points.map((point) => [point[0], point[at + 1] ?? null])}));
}

