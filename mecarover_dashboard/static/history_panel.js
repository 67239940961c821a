// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// What was: events, and the values of one device or bus, with those of others in the same plots, of
// any time span the server remembers.

import {EventList, GAP} from './causes.js';
import {each, h, say, set} from './dom.js';
import {clock, fileName, offset, plural, stamp, zone, zoneName} from './format.js';
import {HistoryCards, unitOf} from './history_cards.js';
import {choice, fill, showChosen} from './parts.js';
import {Pause} from './pause.js';
import {path} from './place.js';
import {Plot} from './plot.js';
import {Plots} from './plots.js';
import {LEVELS} from './store.js';

const SPANS = ['10 min', '1 h', '8 h', '24 h'];
const KINDS = {'': 'All', state: 'States', finding: 'Findings', error: 'Errors'};
const AGAIN_S = 20;            // how old the newest values may become
const LEAST_S = 60;
const AROUND_S = 120;          // so much before and after an event its link shows
const LATEST_S = 20;           // cards show what was recorded in so many s before their time
const STEP_S = 10;             // the server keeps a value for each
const STEPS = 600;             // at most, in the plots and on the slider
const MOST_BESIDE = 3;         // a plot has four kinds of lines

/** Whether a text is a time before now, or now. */
const isRelative = (text) => /^([-\u2212].*|now)?$/.test(text);
const isUnix = (text) => /^[\d.]+$/.test(text);

export class HistoryPanel {
  #asked = -Infinity;          // when, s of the page
  #answer = 0;                 // number of the question that is not answered yet
  #range = null;               // [from, to] of what is shown, Unix s
  #isTyped = false;            // the address does not have the time yet
  #cardsOf = null;             // for which time cards are on their way

  /**
   * of: the name of a device or bus, null for the events of all; from and to: as the server takes
   * them, to = '' for now; at: Unix s in between that is looked at, null for the newest; others:
   * names of what is compared with it.
   * changed() is called when another time is chosen.
   */
  constructor(of, {from = '-1 h', to = '', at = null, kind = '', others = []} = {},
    changed = () => {}) {
    Object.assign(this, {of, from, to, at, kind, changed});
    this.others = of ? others.slice(0, MOST_BESIDE) : [];
    this.usual = isRelative(from) && isRelative(to) ? from : '-1 h';
    this.spans = choice('Time shown', SPANS.map((span) => [`-${span}`, span]),
      (from) => this.#choose(from, ''));
    this.begin = this.#time('from');
    this.end = this.#time('to', 'now');
    this.slider = h('input', {type: 'range', ariaLabel: 'Time looked at', disabled: '', value: 100,
      oninput: () => this.#scrub(Number(this.slider.value)), onchange: () => this.changed()});
    this.when = h('span', {class: 'player-time'});
    this.live = h('button', {class: 'button',
      onclick: () => this.#choose(this.usual, '')}, 'Live');
    this.kinds = choice('Events shown', Object.entries(KINDS), (kind) => this.#only(kind));
    this.pause = new Pause('Events, errors', () => this.update(this.store));
    this.saves = ['csv', 'json'].flatMap((format) => [...of ? ['values'] : [], 'events'].map(
      (what) => h('a', {class: 'button small', 'data-what': what,
        'data-format': format}, `${what} as ${format.toUpperCase()}`)));
    this.problem = h('p', {class: 'message', role: 'status'});
    this.zone = h('p', {class: 'quiet'});
    this.compare = h('select', {ariaLabel: 'Compare with',
      onchange: () => this.#compare(this.compare.value)});
    this.levels = h('div');
    this.plots = new Plots(({name}) => this.#makePlot(name), (cursor) => {
      if (cursor === null) this.#point();
    });
    this.events = new EventList((at, name) =>
      pathAround(at, name, name === of ? this.others : []), of);
    this.cards = new HistoryCards((at, name) => `${path('history', name)}?${
      new URLSearchParams({from: this.from, to: this.to, at: String(at)})}`);
    this.body = h('div', {class: 'past'},
      h('div', {class: 'past-head'}, this.spans, h('label', {}, 'From ', this.begin),
        h('label', {}, 'To ', this.end), this.compare),
      h('div', {class: 'player scrub'}, this.slider, this.when, this.live), this.levels,
      this.plots.element,
      h('div', {class: 'past-head'}, this.kinds, this.pause.element,
        ...this.saves), this.zone,
      h('div', {class: 'past-then'}, this.cards.element, this.events.element));
    this.element = h('div', {class: 'past'}, this.problem, this.body);
  }

  #time(name, placeholder = '') {
    const input = h('input', {placeholder, 'data-time': name, autocomplete: 'off',
      spellcheck: 'false', title: '-10 min, 14:05, yesterday 9:00, 2026-11-28T14:05',
      onchange: () => this.#choose(
        ...['from', 'to'].map((one) => one === name ? input.value.trim() : this[one]))});
    return input;
  }

  close() { this.plots.close(); }

  get #isLive() { return this.at === null && isRelative(this.to); }

  #choose(from, to) {
    Object.assign(this, {from: from || this.usual, to});
    if (isRelative(from) && !to) this.usual = this.from;
    if (isRelative(to)) this.at = null;
    this.#point();
    this.#isTyped = true;
    this.#asked = -Infinity;
    this.update(this.store);
  }

  #only(kind) {
    this.kind = kind;
    this.changed();
    this.#showChoice();
    this.#showEvents();
  }

  get #names() { return this.of ? [this.of, ...this.others] : []; }

  /** Compare with a device or bus of this name; or do so no more. */
  #compare(name) {
    this.others = this.others.includes(name) ? this.others.filter((one) => one !== name)
      : [...this.others, name];
    this.changed();
    this.#asked = -Infinity;
    this.update(this.store);
  }

  #offerOthers() {
    const {of, others} = this;
    const groups = this.store.groups();
    const all = groups.flatMap(({row, devices}) => this.store.buses.has(of) ? row ?? [] : devices)
      .map(({name}) => name).filter((name) => name !== of);
    fill(this.compare, [['', 'Compare with\u2026'], ...all.filter((name) =>
      others.length < MOST_BESIDE || others.includes(name)).map((name) =>
      [name, (others.includes(name) ? 'Remove ' : '') + nameOf(name)])], '');
    this.compare.hidden = !of || !all.length;
  }

  /** Look at a time: what is shown stays, until Live is pressed. */
  #scrub(at) {
    this.at = at;
    this.#fix();
    this.#showTime();
    this.#showEvents();
    this.#showCards();
  }

  /** From now on the time shown is that of the day. */
  #fix() { [this.from, this.to] = this.#range.map((s) => String(Math.round(s))); }

  update(store) {
    this.store = store;
    this.now = store.wall(store.now());
    this.body.hidden = store.history === null;
    if (store.history === null) {
      this.#say(`No history is recorded: ${store.facts.without}.`);
      return;
    }
    this.#offerOthers();
    const now = performance.now() / 1000;
    if (now - this.#asked < (this.#isLive && !this.pause.isOn ? AGAIN_S : Infinity)) return;
    this.#asked = now;
    this.#ask();
  }

  #query(from, to) {
    const query = new URLSearchParams({from, zone: `${offset()} ${zoneName()}`, ...to && {to}});
    for (const name of this.#names) query.append('of', name);
    if (!this.of && this.store.robot !== null) query.set('robot', this.store.robot);
    return query;
  }

  /** A device shares the events of its bus: that no device answered, that the port was closed. */
  #buses() {
    return this.#names.map((name) => this.store.devices.get(name)).filter(Boolean).map(
      ({node, bus}) => `&of=${encodeURIComponent(`${node}: ${`bus ${bus}`.trim()}`)}`).join('');
  }

  async #ask() {
    const number = ++this.#answer;
    const query = this.#query(this.from, this.to);
    this.#showChoice();
    try {
      const [events, values] = await Promise.all([get(`history/events?${query}${this.#buses()}`),
        this.of ? get(`history/values?${query}`) : null]);
      if (number !== this.#answer) return;
      if (events.to - events.from < LEAST_S) {
        throw new Error('to: less than a minute after from; write a later time');
      }
      this.#take(events, values);
    } catch (error) {
      if (number === this.#answer) this.#complain(error);
    }
  }

  #complain(error) {
    this.#say(error instanceof TypeError ? 'No history: no connection.' : error.message, 'error');
  }

  #say(text, state = null) {
    say(this.problem, text);
    set(this.problem, 'data-state', state);
    for (const input of [this.begin, this.end]) {
      set(input, 'aria-invalid', text.startsWith(`${input.dataset.time}:`) || null);
    }
  }

  #take(events, values) {
    const range = this.#range = [events.from, events.to];
    if (this.at < range[0] || this.at > range[1]) this.at = null;
    if (!isRelative(this.to) || this.at !== null) this.#fix();
    else if (!isRelative(this.from)) this.from = String(Math.round(range[0]));
    const query = this.#query(...range.map((s) => s.toFixed(0)));
    query.delete('zone');
    for (const link of this.saves) {
      const {what, format} = link.dataset;
      set(link, 'href', `history/${what}?${query}&format=${format}`);
      set(link, 'download', fileName([this.store.name, ...this.#names.map(nameOf), what,
        stamp(range[0])], format));
    }
    this.shown = [...events.events, ...gapsOf(events)].sort((a, b) => b[0] - a[0]);
    const isCut = events.events.length >= events.most;
    this.#say(isCut ? `Only the newest ${plural(events.most, 'event')} are shown.` : '');
    this.#showValues(values, range);
    this.#showTime();
    this.#showEvents();
    this.#showCards();
    if (this.#isTyped) this.changed();
    this.#isTyped = false;
  }

  /** Say which time is looked at; the cursor of the plots is there. */
  #showTime() {
    const [from, to] = this.#range;
    this.#showChoice();
    set(this.slider, 'disabled', null);
    const step = STEP_S * Math.max(1, Math.ceil((to - from) / STEPS / STEP_S));
    set(this.slider, 'min', step * Math.ceil(from / step));
    set(this.slider, 'max', step * Math.floor(to / step));
    set(this.slider, 'step', step);
    this.slider.value = this.at ?? to;
    const text = this.#isLive ? 'now' : clock(this.at ?? to, this.now);
    set(this.slider, 'aria-valuetext', text);
    say(this.when, text);
    if (this.at !== null) this.#point();
  }

  /** Put the cursor of the plots where it is while no pointer moves it. */
  #point() {
    this.plots.point(this.at === null ? null : this.#range[1] - this.at);
  }

  /** What somebody chose, also while there is no answer. */
  #showChoice() {
    set(this.live, 'aria-pressed', this.#isLive);
    showChosen(this.spans, this.to ? null : this.from);
    showChosen(this.kinds, this.kind);
    for (const [input, given] of [[this.begin, this.from], [this.end, this.to]]) {
      if (document.activeElement === input && !this.#isTyped) continue;
      input.value = isUnix(given) ? clock(Number(given), this.now) : given;
    }
  }

  /** What each part of the robot was at the time looked at: one question after the other. */
  async #showCards() {
    this.cards.element.hidden = this.of !== null || this.at === null;
    if (this.cards.element.hidden || this.#cardsOf !== null) return;
    const at = this.#cardsOf = this.at;
    try {
      const {sources} = await get(`history/values?${this.#query(String(at - LATEST_S), String(at))}`);
      this.cards.show(sources, at, (name) => this.shown.find(([s, one, , kind]) =>
        s <= at && one === name && kind !== 'error')?.[5]);
    } catch (error) {
      this.#complain(error);
      return;
    } finally {
      this.#cardsOf = null;
    }
    if (this.at !== at) this.#showCards();
  }

  #showValues(answer, range) {
    const {sources = {}, step} = answer ?? {};
    const known = this.#names.filter((name) => sources[name]);
    each(this.levels, known, (name) => name,
      () => h('div', {class: 'levels', role: 'img'}), (element, name) =>
        showLevels(element, nameOf(name), runsOf(sources[name].levels, step), range));
    const found = known.flatMap((of) => Object.entries(sources[of].values)
      .filter(([, points]) => points.length)
      .map(([name]) => ({name, unit: unitOf(name, sources[of])})));
    this.plots.update(found, ({name, unit}) => `${name} ${unit}`, (plot, {name, unit}) => {
      plot.update(this.#names.filter((of) => !sources[of] || unitOf(name, sources[of]) === unit)
        .map((of) => ({unit, name: [...this.others.length ? [nameOf(of)] : [],
          name.replaceAll('_', ' ')].join(' '), points: sources[of]?.values[name] ?? [], step,
          remove: of === this.of ? null : () => this.#compare(of)})),
      range[1], {unix: (s) => s, gap: 2.5 * step});
      plot.cover(range[1] - range[0]);
    });
  }

  #makePlot(name) {
    const plot = new Plot(name, 3600);
    plot.onZoom = (zoom) => zoom && this.#choose(...widened(...zoom).map((s) => s.toFixed(0)));
    return plot;
  }

  #showEvents() {
    const {at} = this;
    say(this.zone, `${at === null ? '' : `Events up to ${clock(at, this.now)}. `}Times here: ${
      zone(at ?? this.#range?.[1])}. Times in the files: UTC.`);
    const fits = ([, , , kind]) => !this.kind || kind === this.kind || kind === GAP
      || (this.kind === 'finding' && kind === 'over');
    this.events.update((this.shown ?? []).filter(fits), this.now, at ?? Infinity);
  }
}

/** The address of a source, or of all, around a time; an event of this second is before it. */
function pathAround(at, name, others) {
  const s = Math.ceil(at);
  const query = new URLSearchParams([['from', s - AROUND_S], ['to', s + AROUND_S], ['at', s],
    ...others.map((one) => ['with', one])]);
  return `${path('history', ...name ? [name] : [])}?${query}`;
}

const nameOf = (name) => name.replace(/^.*?: /, '');

/** When nothing was recorded, as events. */
const gapsOf = ({gaps}) => gaps.map(([from, to]) => [to, '', '', GAP, LEVELS.indexOf('stale'),
  `nothing was recorded from ${clock(from)} to ${clock(to)}`]);

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

function showLevels(element, name, runs, [from, to]) {
  const share = (s) => 100 * Math.min(1, Math.max(0, (s - from) / (to - from)));
  each(element, runs.map((run, index) => ({run, index})), ({index}) => index, () => h('i'),
    (part, {run: [begin, end, level]}) => {
      set(part, 'data-state', LEVELS[level] ?? 'stale');
      part.style.left = `${share(begin)}%`;
      part.style.width = `${share(end) - share(begin)}%`;
    });
  const bad = runs.filter(([, , level]) => level > 0).map(([begin, end, level]) =>
    `${LEVELS[level]} from ${clock(begin)} to ${clock(end)}`);
  set(element, 'title', name);
  set(element, 'aria-label', `State of ${name}: ${bad.slice(0, 5).join(', ') || 'ok all the time'}`);
}
