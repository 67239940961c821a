// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// What was: events, and the values of one device or bus, of any time span the server remembers.

import {each, h, icon, say, set, setIcon} from './dom.js';
import {clock, plural, zone} from './format.js';
import {Pause} from './pause.js';
import {path} from './place.js';
import {Plot} from './plot.js';
import {LEVELS} from './store.js';

const SPANS = [[600, '10 min'], [3600, '1 h'], [28800, '8 h'], [86400, '24 h']];
const KINDS = {'': 'All', state: 'States', finding: 'Findings', error: 'Errors'};
const UNITS = {temperature: '\u00b0C', voltage: 'V', loss: '%', latency: 'ms',
  bus_load: '%', packet_rate: '1/s', error_rate: '1/s'};
const unitOf = (name, source) => UNITS[name]
  ?? (name === 'position' ? source.position_unit || 'rad' : source.unit);
const AGAIN_S = 20;            // how old the newest values may become
const LEAST_S = 60;
const AROUND_S = 120;          // so much before and after an event its link shows
const GAP = 'gap';

export class HistoryPanel {
  #plots = new Map();
  #asked = -Infinity;          // when, s of the page
  #answer = 0;                 // number of the question that is not answered yet

  /**
   * of: the name of a device or bus, null for the events of all; from and to: Unix s, or to = null
   * for now and from = a length of time. changed() is called when another time is chosen.
   */
  constructor(of, {from = 3600, to = null, kind = ''} = {}, changed = () => {}) {
    Object.assign(this, {of, from, to, kind, changed});
    this.spans = h('div', {class: 'choice', role: 'group', ariaLabel: 'Time shown'},
      ...SPANS.map(([span, text]) => h('button', {type: 'button', 'data-span': span,
        onclick: () => this.#choose(span, null)}, text)));
    this.begin = this.#time('From');
    this.end = this.#time('To');
    this.kinds = h('div', {class: 'choice', role: 'group', ariaLabel: 'Events shown'},
      ...Object.entries(KINDS).map(([one, text]) => h('button', {type: 'button', 'data-kind': one,
        onclick: () => this.#only(one)}, text)));
    this.pause = new Pause('Events, errors', () => this.update(this.store));
    this.saves = ['csv', 'json'].flatMap((format) => [...of ? ['values'] : [], 'events'].map(
      (what) => h('a', {class: 'button small', download: `${what}.${format}`, 'data-what': what,
        'data-format': format}, `${what} as ${format.toUpperCase()}`)));
    this.problem = h('p', {class: 'quiet', role: 'status'});
    this.zone = h('p', {class: 'quiet'}, `Times here: ${zone()}. Times in the files: UTC.`);
    this.levels = h('div', {class: 'levels', role: 'img', ariaLabel: 'State'});
    this.levels.hidden = true;
    this.graphs = h('div', {class: 'graphs'});
    this.events = h('ol', {class: 'events', tabindex: 0, ariaLabel: 'Events'});
    this.body = h('div', {class: 'past'},
      h('div', {class: 'past-head'}, this.spans, this.begin, this.end), this.levels, this.graphs,
      h('div', {class: 'past-head'}, this.kinds, this.pause.element,
        ...this.saves), this.zone, this.events);
    this.element = h('div', {class: 'past'}, this.problem, this.body);
  }

  #time(text) {
    const input = h('input', {type: 'datetime-local', step: 1, ariaLabel: text,
      onchange: () => this.#typed()});
    return input;
  }

  close() { for (const plot of this.#plots.values()) plot.close(); }

  get range() {
    const to = this.to ?? this.now;
    return [this.to === null ? to - this.from : this.from, to];
  }

  #choose(from, to) {
    Object.assign(this, {from, to});
    this.#asked = -Infinity;
    this.changed();
    this.update(this.store);
  }

  #typed() {
    const [from, to] = [this.begin, this.end].map(({value}) => new Date(value).getTime() / 1000);
    if (to - from >= LEAST_S) this.#choose(from, to);
    else say(this.problem, 'The time shown must be at least a minute: choose a later end.');
  }

  #only(kind) {
    this.kind = kind;
    this.changed();
    this.#showEvents();
  }

  update(store) {
    this.store = store;
    this.now = store.wall(store.now());
    for (const button of this.spans.children) {
      set(button, 'aria-pressed', this.to === null && Number(button.dataset.span) === this.from);
    }
    this.body.hidden = store.history === null;
    if (store.history === null) {
      say(this.problem, `No history is recorded: ${store.facts.without}.`);
      return;
    }
    const now = performance.now() / 1000;
    const isStill = this.to !== null || this.pause.isOn;
    if (now - this.#asked < (isStill ? Infinity : AGAIN_S)) return;
    this.#asked = now;
    this.#ask();
  }

  #query(range) {
    const query = new URLSearchParams({from: range[0].toFixed(0), to: range[1].toFixed(0)});
    if (this.of) query.set('of', this.of);
    else if (this.store.robot !== null) query.set('robot', this.store.robot);
    return query;
  }

  /** A device shares the events of its bus: that no device answered, that the port was closed. */
  #bus() {
    const device = this.store.devices.get(this.of);
    return device ? `&of=${encodeURIComponent(`${device.node}: ${`bus ${device.bus}`.trim()}`)}`
      : '';
  }

  async #ask() {
    const number = ++this.#answer;
    const range = this.range;
    const query = this.#query(range);
    for (const link of this.saves) {
      set(link, 'href', `history/${link.dataset.what}?${query}&format=${link.dataset.format}`);
    }
    for (const [input, s] of [[this.begin, range[0]], [this.end, range[1]]]) {
      if (document.activeElement !== input) input.value = local(s);
    }
    try {
      const [events, values] = await Promise.all([get(`history/events?${query}${this.#bus()}`),
        this.of ? get(`history/values?${query}`) : null]);
      if (number !== this.#answer) return;
      this.shown = [...events.events, ...gapsOf(events)].sort((a, b) => b[0] - a[0]);
      this.isCut = events.events.length >= events.most;
      say(this.problem, '');
      this.#showValues(values, range);
      this.#showEvents();
    } catch (error) {
      say(this.problem, `No history: ${error.message}`);
    }
  }

  #showValues(answer, range) {
    const source = answer?.sources[this.of];
    const values = Object.entries(source?.values ?? {}).filter(([, points]) => points.length);
    const gap = 2.5 * (answer?.step ?? 1);
    this.levels.hidden = !source;
    if (source) showLevels(this.levels, runsOf(source.levels, answer.step), range);
    each(this.graphs, values, ([name]) => name, ([name]) => this.#graph(name),
      (figureElement, [name, points]) => this.#plots.get(name).update(
        [{name: name.replaceAll('_', ' '), unit: unitOf(name, source), points}],
        range[1], {unix: (s) => s, gap}));
    for (const [name, plot] of this.#plots) {
      plot.cover(range[1] - range[0]);
      if (!values.some(([one]) => one === name)) {
        plot.close();
        this.#plots.delete(name);
      }
    }
  }

  #graph(name) {
    const plot = new Plot(name, 3600);
    plot.onZoom = (zoom) => zoom && this.#choose(...widened(...zoom.map(Math.round)));
    this.#plots.set(name, plot);
    return plot.element;
  }

  #showEvents() {
    for (const button of this.kinds.children) {
      set(button, 'aria-pressed', button.dataset.kind === this.kind);
    }
    const fits = ([, , , kind]) => !this.kind || kind === this.kind || kind === GAP
      || (this.kind === 'finding' && kind === 'over');
    const shown = (this.shown ?? []).filter(fits).map((event, index) => ({event, index}));
    const lines = shown.length ? shown : [{event: null, index: 'none'}];
    each(this.events, lines, ({index}) => index,
      ({event}) => event ? makeEvent() : h('li', {class: 'quiet'}, 'No events in this time.'),
      (item, {event}) => { if (event) this.#showEvent(item, event); });
    if (this.isCut) {
      say(this.problem, `Only the newest ${plural(this.shown.length, 'event')} are shown.`);
    }
  }

  #showEvent(item, [at, name, , kind, level, text]) {
    const [symbol, time, link, words] = item.children;
    const state = LEVELS[level] ?? 'stale';
    set(item, 'data-state', state);
    setIcon(symbol, state);
    say(time, clock(at, this.now));
    set(link, 'href', `${path('history', name)}?from=${Math.floor(at) - AROUND_S}`
      + `&to=${Math.floor(at) + AROUND_S}`);
    link.hidden = kind === GAP;
    say(link, name.replace(/^.*?: /, ''));
    say(words, kind === 'over' ? `ended: ${text}` : text);
  }
}

/** When nothing was recorded, as lines among the events. */
const gapsOf = ({gaps}) => gaps.map(([from, to]) => [to, '', '', GAP, LEVELS.indexOf('stale'),
  `nothing was recorded from ${clock(from)} to ${clock(to)}`]);

const makeEvent = () => h('li', {}, icon('ok'), h('time'), h('a'), h('span'));

async function get(address) {
  const answer = await fetch(address, {cache: 'no-store'});
  if (!answer.ok) throw new Error((await answer.text()).trim());
  return answer.json();
}

/** At least a minute around the middle. */
function widened(from, to) {
  const missing = Math.max(0, LEAST_S - (to - from)) / 2;
  return [from - missing, to + missing];
}

/** Unix seconds as an input of date and time takes them: local time. */
function local(s) {
  const at = new Date(1000 * s);
  const shifted = new Date(at.getTime() - 60_000 * at.getTimezoneOffset());
  return shifted.toISOString().slice(0, 19);
}

/** Times of one level that follow each other: [[from, to, level], ...]. */
function runsOf(levels, step) {
  const runs = [];
  for (const [at, level] of levels) {
    const last = runs.at(-1);
    if (last && last[2] === level && at - last[1] < 2 * step) last[1] = at + step;
    else runs.push([at, at + step, level]);
  }
  return runs;
}

function showLevels(element, runs, [from, to]) {
  const share = (s) => 100 * Math.min(1, Math.max(0, (s - from) / (to - from)));
  each(element, runs.map((run, index) => ({run, index})), ({index}) => index, () => h('i'),
    (part, {run: [begin, end, level]}) => {
      set(part, 'data-state', LEVELS[level] ?? 'stale');
      part.style.left = `${share(begin)}%`;
      part.style.width = `${share(end) - share(begin)}%`;
    });
  const bad = runs.filter(([, , level]) => level > 0).map(([begin, end, level]) =>
    `${LEVELS[level]} from ${clock(begin)} to ${clock(end)}`);
  set(element, 'aria-label', `State: ${bad.slice(0, 5).join(', ') || 'ok all the time'}`);
}
