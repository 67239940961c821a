// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// View 7: chosen registers of any servos over the last minute, at the rate of the bus; one plot
// for each unit, so that goal and present position lie over each other.

import {each, h, say, set} from './dom.js';
import {clock, figure, id3, numberOf, splitUnit} from './format.js';
import {fillEmpty} from './parts.js';
import {keepFilters, path} from './place.js';
import {Plot} from './plot.js';
import {csvOf, MOST, Signal, Signals, SPAN_S} from './signal.js';
import {measured, shownIn} from './units.js';

const SPANS = [[5, '5 s'], [20, '20 s'], [SPAN_S, '60 s']];
const FIRST = ['Present Position', 'Goal Position', 'Present Current', 'Present Load',
  'Present Velocity', 'Present Temperature', 'Present Input Voltage'];   // at the top of the list
const NO_UNIT = 'no unit';
const MOST_LINES = 4;          // in a plot

/** The address that shows some registers of a device at the rate of the bus. */
export const pathOfSignals = (device, keys) => `${path('signals')}?${new URLSearchParams(
  keys.flatMap((key) => [['of', device], ['register', key]]))}`;

export class SignalsView {
  title = 'Signals';
  #plots = new Map();
  #span = 20;
  #zoom = null;                // [from, to] in s; null: up to now

  constructor(_, filters) {
    this.signals = new Signals(() => this.#draw(), (text) => { this.problem = text; });
    const keys = filters.getAll('register');
    this.isFirst = !keys.length;
    this.signals.all = filters.getAll('of').slice(0, MOST)
      .map((device, index) => new Signal(device, keys[index] ?? ''));
    this.problem = '';
    this.watch = filters.get('of') ?? '';
    this.device = h('select', {ariaLabel: 'Device', onchange: () => {
      this.watch = this.device.value;
      this.update(this.store);
    }});
    this.register = h('select', {ariaLabel: 'Register', onchange: () => this.update(this.store)});
    this.add = h('button', {type: 'button', class: 'button', onclick: () => this.#change()});
    this.spans = h('div', {class: 'choice', role: 'group', ariaLabel: 'Time shown'},
      ...SPANS.map(([span, text]) => h('button', {type: 'button', 'data-span': span,
        onclick: () => this.#show(span)}, text)));
    this.pause = h('button', {type: 'button', class: 'button', onclick: () => this.#pause()});
    this.csv = h('button', {type: 'button', class: 'button', onclick: () => this.#save()}, 'CSV');
    this.words = h('p', {class: 'quiet', role: 'status'});
    this.empty = h('div', {class: 'empty'});
    this.graphs = h('div', {class: 'graphs'});
    this.body = h('section', {class: 'panel signals'},
      h('div', {class: 'past-head'}, this.device, this.register, this.add),
      h('div', {class: 'past-head'}, this.spans, this.pause, this.csv), this.words, this.graphs);
    this.element = h('div', {}, h('h1', {class: 'unseen', tabindex: -1}, 'Signals'), this.empty,
      this.body);
    this.signals.open();
    this.#show(this.#span);
  }

  close() {
    this.signals.close();
    for (const plot of this.#plots.values()) plot.close();
  }

  #show(span) {
    this.#span = span;
    this.#zoom = null;
    if (!this.signals.isOpen) this.signals.open();
    this.#draw();
  }

  #pause() {
    if (this.signals.isOpen) this.signals.close();
    else this.#show(this.#span);
    this.#draw();
  }

  /** Add the register of the lists; or take it away, where it is shown. */
  #change() {
    const {signals, register} = this;
    if (this.shown) {
      this.#keep(signals.all.filter((one) => one !== this.shown));
    } else {
      const added = new Signal(this.watch, register.value);
      register.selectedIndex = (register.selectedIndex + 1) % register.length;
      this.#keep([...signals.all, added]);
    }
  }

  #keep(all) {
    this.isFirst = false;
    this.signals.all = all;
    keepFilters(all.flatMap(({device, key}) => [['of', device], ['register', key]]));
    this.update(this.store);
  }

  update(store) {
    this.store = store;
    const devices = store.groups().flatMap((group) => group.devices);
    this.empty.hidden = devices.length > 0;
    this.body.hidden = !devices.length;
    if (!devices.length) fillEmpty(this.empty, store);
    if (!store.devices.has(this.watch)) this.watch = devices[0]?.name ?? '';
    fill(this.device, devices.map((one) => [one.name, nameOf(one, devices)]), this.watch);
    const fields = store.table?.name === this.watch ? store.table.fields : [];
    const rank = ({key}) => (FIRST.indexOf(splitUnit(key)[0]) + FIRST.length + 1)
      % (FIRST.length + 1);
    fill(this.register, fields.filter(({value, raw}) => Number.isFinite(numberOf(raw || value)))
      .sort((a, b) => rank(a) - rank(b)).map(({key}) => [key, shownKey(key)]));
    if (this.isFirst && fields.length) {            // somebody who chose nothing sees something
      const first = FIRST.slice(0, 2).flatMap((name) =>
        fields.filter(({key}) => splitUnit(key)[0] === name));
      this.register.selectedIndex = first.length % this.register.length;
      this.#keep(first.map(({key}) => new Signal(this.watch, key)));
      return;
    }
    this.shown = this.signals.all.find((one) =>
      one.device === this.watch && one.key === this.register.value);
    say(this.add, this.shown ? 'Remove' : 'Add');
    set(this.add, 'title', `Up to ${MOST} registers`);
    set(this.add, 'disabled',
      !this.shown && (this.signals.all.length >= MOST || !this.register.value));
    say(this.words, this.problem || this.#advice());
    this.#draw();
  }

  get isSampled() { return !this.store.facts.source; }

  #advice() {
    const {all} = this.signals;
    const slow = this.isSampled ? 'Each dot is a sample: ROS topics carry registers at '
      + 'publish_rate only, and what was on the bus in between is not known. '
      + 'All values: dxl_dashboard SOURCE, without ROS.' : '';
    if (!all.length) return `Choose up to ${MOST} registers of any servos. ${slow}`;
    return slow;
  }

  #draw() {
    const {all, now, isOpen} = this.signals;
    if (!this.store) return;
    for (const button of this.spans.children) {
      set(button, 'aria-pressed', !this.#zoom && Number(button.dataset.span) === this.#span);
    }
    say(this.pause, isOpen ? 'Pause' : 'Paused');
    set(this.pause, 'aria-pressed', !isOpen);
    set(this.csv, 'disabled', !all.length);
    const [from, to] = this.range;
    const groups = groupsOf(all);
    each(this.graphs, groups, ({key}) => key, (one) => this.#makePlot(one), (element, one) => {
      const {key, some} = one;
      set(element, 'data-empty', some.every((one) => one.end === one.begin));
      const plot = this.#plots.get(key);
      plot.cover(to - from, {isQuiet: true});
      plot.update(some.map((signal) => {
        const points = signal.drawn(from, to, plot.width, now);
        const [, unit] = splitUnit(signal.key);
        return {name: this.#name(signal), unit, points,
          note: [...rateOf(signal, now, this.isSampled), ...extremes(points, unit),
            ...averageOf(signal, from, to, unit)].join(', '),
          hasDots: !signal.isWritten, isSampled: this.isSampled,
          remove: () => this.#keep(this.signals.all.filter((one) => one !== signal))};
      }), to, {gap: Infinity, rest: 0, zero: now,
        timeOfDay: (s) => this.#timeOfDay(s)});
    });
    for (const [key, plot] of this.#plots) {
      if (groups.some((one) => one.key === key)) continue;
      plot.close();
      this.#plots.delete(key);
    }
  }

  /** ' (14:02:07.250)'; a recording has times of its own. */
  #timeOfDay(s) {
    if (this.store.player) return '';
    const ms = Math.floor(1000 * (s + this.signals.origin));
    return ` (${clock(ms / 1000, ms / 1000)}.${String(ms % 1000).padStart(3, '0')})`;
  }

  get range() {
    return this.#zoom ?? [this.signals.now - this.#span, this.signals.now];
  }

  #makePlot({key, unit}) {
    const plot = new Plot(`Signals, ${shownIn(unit)[0]}`);
    plot.onZoom = (zoom) => {
      if (!zoom) {
        this.#show(this.#span);
        return;
      }
      this.#zoom = zoom;
      this.signals.close();
      this.#draw();
    };
    plot.bounds = () => [this.signals.now - SPAN_S, this.signals.now];
    plot.onMark = (s) => {
      for (const other of this.#plots.values()) if (other !== plot) other.mark(s);
    };
    plot.onCursor = (cursor) => {
      for (const other of this.#plots.values()) if (other !== plot) other.point(cursor);
    };
    this.#plots.set(key, plot);
    return plot.element;
  }

  #name({device, key}) {
    const row = this.store.devices.get(device);
    const devices = this.store.groups().flatMap((group) => group.devices);
    return `${row ? nameOf(row, devices) : device} ${splitUnit(key)[0]}`;
  }

  /** The first register, and when the time shown begins (UTC): files of two choices differ. */
  #fileName(origin) {
    const [from] = this.range;
    const begin = this.store.player ? `${from.toFixed(3)}s`
      : `${new Date(1000 * (from + origin)).toISOString().slice(0, 19).replaceAll(':', '')}Z`;
    return `${this.#name(this.signals.all[0])} ${begin}.csv`.replace(/[^\w.-]+/g, '_');
  }

  #save() {
    const {all, origin} = this.signals;
    const names = all.map((signal) => `${this.#name(signal)}${unitOf(signal.key)}`);
    const text = csvOf(all, names, this.range,
      this.store.player ? 'recording (s)' : 'Unix time (s)', origin);
    const link = h('a', {download: this.#fileName(origin),
      href: URL.createObjectURL(new Blob([text], {type: 'text/csv'}))});
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  }
}

/** What shares a plot: up to four registers of one unit, those of a servo next to each other. */
function groupsOf(signals) {
  const units = new Map();
  const byDevice = (a, b) => a.device < b.device ? -1 : Number(a.device > b.device);
  for (const signal of [...signals].sort(byDevice)) {
    const [, unit] = splitUnit(signal.key);
    units.set(unit, [...units.get(unit) ?? [], signal]);
  }
  return [...units].flatMap(([unit, all]) => [0, MOST_LINES].map((from) => ({
    key: `${unit} ${from}`, unit: unit || NO_UNIT, some: all.slice(from, from + MOST_LINES)})))
    .filter(({some}) => some.length);
}

const unitOf = (key) => splitUnit(key)[1] && ` (${splitUnit(key)[1]})`;

function shownKey(key) {
  const [name, unit] = splitUnit(key);
  return unit ? `${name} (${shownIn(unit)[0]})` : name;
}

/** '007 left_knee', with its bus where there are several. */
function nameOf({id, joint, bus}, devices) {
  return [id3(id), joint, devices.some((one) => one.bus !== bus) && bus].filter(Boolean).join(' ');
}

const rateOf = (signal, now, isSampled) => signal.end > signal.begin
  ? [`${figure(signal.rate(now), 2)} ${isSampled ? 'samples/s' : '/s'}`] : [];

/** The lowest and highest of what is shown, as a text; nothing where they are one. */
function extremes(points, reported) {
  const [unit, factor] = shownIn(reported);
  const known = points.filter(([, value]) => value !== null);
  const low = factor * Math.min(...known.map((point) => point[1]));
  const high = factor * Math.max(...known.map((point) => point[2]));
  return low < high ? [`${measured(low, unit)} to ${measured(high, unit)}`] : [];
}

/** Nothing of what was written: the mean of rare writes is not that of the time they hold. */
function averageOf(signal, from, to, reported) {
  if (signal.isWritten) return [];
  const [unit, factor] = shownIn(reported);
  const {count, mean, deviation} = signal.statistics(from, to);
  return deviation > 0
    ? [`mean ${measured(factor * mean, unit)}, \u03c3 ${figure(factor * deviation, 3)} of ${count}`]
    : [];
}

/** Fill a select with [value, text]. */
function fill(select, options, value = select.value) {
  each(select, options, ([one]) => one, ([one]) => h('option', {value: one}),
    (option, [, text]) => say(option, text));
  if (options.some(([one]) => one === value)) select.value = value;
}
