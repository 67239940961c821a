// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// View 4: the figures of the thesis per bus, its load, a plot of any of them, findings, errors.

import {makeFact} from './bridge.js';
import {each, h, icon, say, sayWords, set, showState} from './dom.js';
import {ErrorList, errorsOf} from './errors.js';
import {FindingList, makeFinding, showFinding} from './findings.js';
import {numberOf, short} from './format.js';
import {fillEmpty, metricsHead, metricToPlot, panel, seriesOf, showMetrics} from './parts.js';
import {Pause} from './pause.js';
import {path} from './place.js';
import {Plot} from './plot.js';
import {stateOf, valueOf} from './store.js';

const THESIS = ['time_per_buffer', 'time_between_buffers', 'bytes_per_buffer', 'bus_load',
  'byte_rate', 'packet_rate', 'error_rate'];
const LOADED = 90;             // % of the wire's time: little is left for a reply that is late

const table = (kind, caption, ...content) =>
  h('table', {class: kind}, h('caption', {class: 'unseen'}, caption), ...content);

export class LogView {
  constructor([bus]) {
    this.bus = bus;
    this.title = 'Log and timing';
    this.metric = null;        // chosen by hand
    this.plot = new Plot('Timing', 300);
    this.choice = h('nav', {class: 'choice', ariaLabel: 'Bus'});
    this.empty = h('div', {class: 'empty'});
    this.load = h('div', {class: 'gauge', role: 'meter', ariaLabel: 'Bus load',
      'aria-valuemin': 0, 'aria-valuemax': 100},
    h('b'), h('span', {class: 'gauge-bar'}, h('i')), h('span', {class: 'quiet'}, 'Bus load'));
    this.rows = h('tbody');
    this.counters = h('tbody');
    this.doubts = h('ul', {class: 'findings doubts'});
    this.untold = h('details', {}, h('summary', {class: 'quiet'}), this.doubts);
    this.pause = new Pause('Findings and errors', () => this.update(this.store));
    this.findings = new FindingList('Findings', this.pause, this.untold);
    this.errors = new ErrorList('Last errors', this.pause);
    this.status = h('p', {class: 'message'}, icon('ok'), h('span'));
    this.body = this.#lay();
    this.element = h('div', {},
      h('div', {class: 'head'}, h('h1', {tabindex: -1}, this.title), this.choice,
        this.pause.element), this.empty, this.body);
  }

  #lay() {
    return h('div', {class: 'columns'},
      h('div', {},
        panel('Timing', this.load, table('figures', 'Timing over the last 10 s', metricsHead(),
          this.rows)),
        h('section', {class: 'panel', ariaLabel: 'Plot'}, this.plot.element)),
      h('div', {}, this.findings.element, this.errors.element,
        panel('Bus', this.status, table('fields facts', 'Counters of the bus', this.counters))));
  }

  close() { this.plot.close(); }

  update(store) {
    this.store = store;
    const groups = store.groups();
    this.empty.hidden = groups.length > 0;
    this.body.hidden = this.pause.element.hidden = !groups.length;
    if (!groups.length) {
      fillEmpty(this.empty, store);
      return;
    }
    const group = groups.find((one) => one.key === this.bus) ?? groups[0];
    this.choice.hidden = groups.length < 2;
    each(this.choice, groups, (one) => one.key,
      (one) => h('a', {href: path('log', one.key)}, icon('ok'), h('span')), (link, one) => {
        say(link.lastChild, one.label);
        showState(link, one.state);
        set(link, 'aria-current', one === group ? 'page' : null);
      });
    this.#timing(store, group);
    this.#bus(store, group);
  }

  #timing(store, group) {
    const metrics = store.metrics(group.node, group.bus);
    const own = store.metrics(group.node, '');
    if (own.has('resident_memory')) metrics.set('resident_memory', own.get('resident_memory'));
    this.#load(numberOf(valueOf(metrics.get('bus_load'), 'value (%)') ?? ''));
    const names = [...THESIS.filter((name) => metrics.has(name)),
      ...[...metrics.keys()].filter((name) => !THESIS.includes(name))];
    const metric = this.metric ?? metricToPlot(metrics, 'bus_load');
    showMetrics(this.rows, names.map((name) => metrics.get(name)), metric, (name) => {
      this.metric = name;
      this.update(store);
    });
    this.plot.label = metric.replaceAll('_', ' ');
    this.plot.update(seriesOf(metrics.get(metric)), store.now(),
      metric === 'bus_load' ? {low: 0} : {});
  }

  #load(load) {
    this.load.hidden = !Number.isFinite(load);
    say(this.load.firstChild, `${short(String(load), 3)} %`);
    set(this.load, 'aria-valuenow', Math.round(load));
    this.load.children[1].firstChild.style.width = `${Math.min(100, load)}%`;
    set(this.load, 'data-state', load > LOADED ? 'warn' : 'ok');
  }

  #bus(store, group) {
    const {row} = group;
    const state = stateOf(row);
    showState(this.status, state);
    const text = group.part.is_known ? row?.message ?? 'no status of the bus yet'
      : store.said(group.part);
    sayWords(this.status.lastChild, text);
    this.status.hidden = Boolean(row?.findings.some(([, finding]) => finding === text));
    set(this.body, 'data-known', String(group.part.is_known));
    this.findings.update([group], store);
    const doubts = row?.doubts ?? [];
    this.untold.hidden = !doubts.length;
    say(this.untold.firstChild, `${doubts.length} not known yet`);
    each(this.doubts, doubts, ([rule]) => rule, () => makeFinding('stale'),
      (item, [rule, text]) => showFinding(item, [rule, text, 'stale']));
    this.errors.update(errorsOf([group], store));
    each(this.counters, row?.values ?? [], ([key]) => key, makeFact,
      (line, [, value]) => say(line.children[1], value));
  }
}
