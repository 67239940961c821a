// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// View 7: chosen registers of any servos over the last minute, at the rate of the bus; one plot
// for each unit, so that goal and present position lie over each other.

import {h, say, set} from './dom.js';
import {clock, figure, fileName, id3, isoTime, numberOf, splitUnit, stamp} from './format.js';
import {choice, fill, fillEmpty, showChosen} from './parts.js';
import {keepFilters, path} from './place.js';
import {Plot} from './plot.js';
import {Plots} from './plots.js';
import {csvOf, Difference, MOST, Signal, Signals, SPAN_S} from './signal.js';
import {measured, shownIn} from './units.js';

const SPANS = [[5, '5 s'], [20, '20 s'], [SPAN_S, '60 s']];
const FIRST = ['Present Position', 'Goal Position', 'Present Current', 'Present Load',
  'Present Velocity', 'Present Temperature', 'Present Input Voltage'];   // at the top of the list
const NO_UNIT = 'no unit';
const MOST_LINES = 4;          // in a plot
const REST_MS = 300;           // after a move, until the address has it

/** The address that shows some registers of a device at the rate of the bus. */
export const pathOfSignals = (device, keys) => `${path('signals')}?${new URLSearchParams(
  keys.flatMap((key) => [['of', device], ['register', key]]))}`;

export class SignalsView {
  title = 'Signals';
  #span = 20;
  #zoom = null;                // [from, to] in s; null: up to now
  #mark = null;                // s
  #cursor = null;              // s, where it was last
  #wanted = null;              // what the address asks for, until the clock is known

  constructor(_, filters) {
    this.signals = new Signals(() => this.#draw(), (text) => { this.problem = text; });
    const keys = filters.getAll('register');
    this.isFirst = !keys.length;
    this.signals.all = filters.getAll('of').slice(0, MOST)
      .map((device, index) => new Signal(device, keys[index] ?? ''));
    this.differences = filters.getAll('minus').map((pair) =>
      pair.split('.').map((index) => this.signals.all[index]))
      .filter(([one, other]) => one && other).map(([one, other]) => new Difference(one, other));
    this.problem = '';
    this.query = filters.toString();         // as the address has it
    this.watch = filters.get('of') ?? '';
    this.device = h('select', {ariaLabel: 'Device', onchange: () => {
      this.watch = this.device.value;
      this.key = this.meant;
      this.update(this.store);
    }});
    this.register = h('select', {ariaLabel: 'Register', onchange: () => {
      this.meant = this.register.value;
      this.key = undefined;
      this.update(this.store);
    }});
    this.add = h('button', {class: 'button', onclick: () => this.#change()});
    this.addAll = h('button', {class: 'button', onclick: () => this.#addAll(),
      title: `This register of each servo of this model, up to ${MOST} registers`}, 'Add for all');
    this.minus = h('select', {ariaLabel: 'Difference', onchange: () => this.#subtract()});
    this.spans = choice('Time shown', SPANS, (span) => this.#show(span));
    this.pause = h('button', {class: 'button', onclick: () => this.#pause()});
    this.marks = h('button', {class: 'button', title: 'Count from the cursor',
      onclick: () => this.#setMark(this.#mark === null ? this.#cursor : null)}, 'Mark');
    this.csv = h('button', {class: 'button', onclick: () => this.#save()}, 'CSV');
    this.words = h('p', {class: 'quiet', role: 'status'});
    this.empty = h('div', {class: 'empty'});
    this.plots = new Plots(() => this.#makePlot(), (cursor) => {
      if (cursor !== null) this.#cursor = this.range[1] - cursor;
      if (this.#zoom) this.#remember();
    });
    this.body = h('section', {class: 'panel signals'},
      h('div', {class: 'past-head'}, this.device, this.register, this.add, this.addAll,
        this.minus),
      h('div', {class: 'past-head'}, this.spans, this.pause, this.marks, this.csv), this.words,
      this.plots.element);
    this.element = h('div', {}, h('h1', {class: 'unseen', tabindex: -1}, 'Signals'), this.empty,
      this.body);
    this.#span = SPANS.find(([span]) => span === Number(filters.get('span')))?.[0] ?? this.#span;
    const [from, to, mark, cursor] = ['from', 'to', 'mark', 'cursor'].map((name) =>
      filters.has(name) ? Number(filters.get(name)) : null);
    if (from !== null && from < to) {
      this.#wanted = {from, to, mark, cursor};
      this.signals.fill();
    } else {
      this.signals.open();
    }
  }

  close() {
    this.wasOpen = this.signals.isOpen;
    this.signals.close();
    clearTimeout(this.timer);
  }

  /** Go on after close(), with the same choice, and paused where it was. */
  resume() {
    if (this.wasOpen) this.signals.open();
    if (!this.#wanted) this.#keepPlace();
  }

  #show(span) {
    this.#span = span;
    this.#zoom = null;
    if (!this.signals.isOpen) this.signals.open();
    this.plots.point(null);
    this.#keepPlace();
    this.#draw();
  }

  #pause() {
    if (this.signals.isOpen) this.#stopAt(this.range);
    else this.#show(this.#span);
  }

  #stopAt(zoom) {
    this.#zoom = zoom;
    this.gone = '';
    this.signals.close();
    this.#remember();
    this.#draw();
  }

  #setMark(s) {
    this.#mark = s;
    this.#remember();
    this.#draw();
    this.#placeCursors();
  }

  #placeCursors() {
    this.plots.mark(this.#mark);
    if (this.#zoom && this.#cursor !== null) this.plots.point(this.#zoom[1] - this.#cursor);
  }

  /** Write what is shown into the address, soon; times where it does not move. */
  #remember() {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.#keepPlace(), REST_MS);
  }

  #keepPlace() {
    clearTimeout(this.timer);
    const {all, origin} = this.signals;
    const times = this.#zoom
      ? [['from', this.#zoom[0]], ['to', this.#zoom[1]], ['mark', this.#mark],
        ['cursor', this.#cursor]] : [];
    this.query = keepFilters([
      ...all.flatMap(({device, key}) => [['of', device], ['register', key]]),
      ...this.differences.map(({parts}) =>
        ['minus', parts.map((one) => all.indexOf(one)).join('.')]),
      ['span', this.#span], ...times.filter(([, s]) => s !== null)
        .map(([name, s]) => [name, (s + origin).toFixed(3)])]);
  }

  /** Show the time that the address names, or say that it is no longer there. */
  #goToWanted() {
    const {signals} = this;
    const {from, to, mark, cursor} = this.#wanted;
    this.#wanted = null;
    if (from - signals.origin > signals.now || to - signals.origin < signals.now - SPAN_S) {
      this.gone = 'The time of this link is over: a minute is kept.';
      this.#show(this.#span);
      return;
    }
    const here = (s) => s === null ? null : s - signals.origin;
    [this.#mark, this.#cursor] = [here(mark), here(cursor)];
    this.#stopAt([here(from), here(to)]);
    this.#placeCursors();
  }

  /** Add the register of the lists; or take it away, where it is shown. */
  #change() {
    const {signals, register} = this;
    if (this.shown) {
      this.#remove(this.shown);
    } else {
      const added = new Signal(this.watch, register.value);
      this.meant = added.key;
      register.selectedIndex = (register.selectedIndex + 1) % register.length;
      this.#keep([...signals.all, added]);
    }
  }

  /** Add the register of the lists for all servos of this model. */
  #addAll() {
    const {all} = this.signals;
    const {model} = this.store.devices.get(this.watch);
    const others = this.devices.filter((one) => one.model === model && !all.some(
      ({device, key}) => device === one.name && key === this.register.value));
    this.#keep([...all, ...others.map(({name}) => new Signal(name, this.register.value))]
      .slice(0, MOST));
  }

  /** Add the difference that was chosen; or take it away, where it is shown. */
  #subtract() {
    const [one, other] = this.minus.value.split('.').map((index) => this.signals.all[index]);
    const shown = this.differences.find(({parts}) => parts[0] === one && parts[1] === other);
    this.differences = shown ? this.differences.filter((each) => each !== shown)
      : [...this.differences, new Difference(one, other)];
    this.minus.value = '';
    this.#keep(this.signals.all);
  }

  #remove(signal) {
    this.differences = this.differences.filter((one) => one !== signal);
    this.#keep(this.signals.all.filter((one) => one !== signal));
  }

  #keep(all) {
    this.isFirst = false;
    this.signals.all = all;
    this.differences = this.differences.filter(({parts}) =>
      parts.every((one) => all.includes(one)));
    this.signals.fill();
    this.#keepPlace();
    const count = this.plots.size;
    this.update(this.store);
    if (this.plots.size <= count) return;
    this.#placeCursors();
    this.plots.element.lastChild.scrollIntoView({block: 'nearest'});
  }

  update(store) {
    this.store = store;
    const devices = this.devices = store.groups().flatMap((group) => group.devices);
    this.empty.hidden = devices.length > 0;
    this.body.hidden = !devices.length;
    if (!devices.length) fillEmpty(this.empty, store);
    if (!store.devices.has(this.watch)) this.watch = devices[0]?.name ?? '';
    fill(this.device, devices.map((one) => [one.name, nameOf(one, devices)]), this.watch);
    const fields = store.table?.name === this.watch ? store.table.fields : [];
    const rank = ({key}) => (FIRST.indexOf(splitUnit(key)[0]) + FIRST.length + 1)
      % (FIRST.length + 1);
    fill(this.register, fields.filter(({value, raw}) => Number.isFinite(numberOf(raw || value)))
      .sort((a, b) => rank(a) - rank(b)).map(({key}) => [key, shownKey(key)]), this.key);
    if (this.register.value === this.key) this.key = undefined;
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
    const isFull = this.signals.all.length >= MOST || !this.register.value;
    set(this.add, 'disabled', !this.shown && isFull);
    set(this.addAll, 'disabled', isFull);
    this.#offerDifferences();
    say(this.words, this.problem || this.#advice());
    this.#draw();
  }

  get isSampled() { return !this.store.facts.source; }

  #offerDifferences() {
    const {all} = this.signals;
    const pairs = all.flatMap((one, first) => all.flatMap((other, second) =>
      one !== other && splitUnit(one.key)[1] === splitUnit(other.key)[1]
        ? [[`${first}.${second}`, [one, other]]] : []));
    const isShown = (pair) => this.differences.some(({parts}) =>
      parts.every((part, at) => part === pair[at]));
    fill(this.minus, [['', 'Difference\u2026'], ...pairs.map(([value, pair]) =>
      [value, (isShown(pair) ? 'Remove ' : '') + this.#nameOfPair(...pair)])], '');
    this.minus.hidden = !pairs.length;
  }

  #advice() {
    const {all, now} = this.signals;
    const rate = Math.max(0, ...all.map((one) => one.rate(now)));
    const slow = this.isSampled ? `${rate ? `${figure(rate, 1)} Hz samples` : 'Samples'} from `
      + 'dxl/diagnostics (publish_rate); what was in between is unknown. '
      + 'All values: dxl_dashboard SOURCE, without ROS.' : '';
    if (!all.length) return `Choose up to ${MOST} registers of any servos. ${slow}`;
    return [this.gone, slow].filter(Boolean).join(' ');
  }

  #draw() {
    const {all, now, isOpen} = this.signals;
    if (!this.store) return;
    if (this.#wanted) {
      if (now) this.#goToWanted();
      return;
    }
    for (const one of this.differences) one.update();
    showChosen(this.spans, this.#zoom ? null : this.#span);
    say(this.pause, isOpen ? 'Pause' : 'Paused');
    set(this.pause, 'aria-pressed', !isOpen);
    set(this.csv, 'disabled', !all.length);
    const [from, to] = this.range;
    set(this.marks, 'aria-pressed', this.#mark !== null);
    const groups = [...groupsOf(all), ...groupsOf(this.differences, 'difference ')];
    this.plots.update(groups, ({key}) => key, (plot, {unit, some}, element) => {
      set(element, 'data-empty', some.every((one) => one.end === one.begin));
      plot.label = `Signals, ${shownIn(unit)[0]}`;
      plot.cover(to - from, {isQuiet: true});
      plot.isZoomed = Boolean(this.#zoom);
      plot.next = (s, by) => nextOf(some, s, by);
      plot.update(some.map((signal) => {
        const points = signal.drawn(from, to, plot.width, now);
        return {name: this.#name(signal), unit: splitUnit(signal.key)[1], points,
          note: statisticsOf(signal, from, to, this.isSampled),
          pointAt: (s) => signal.pointAt(s), hasDots: !signal.isWritten, isSampled: this.isSampled,
          remove: () => this.#remove(signal)};
      }), to, {gap: Infinity, rest: 0, zero: now,
        timeOfDay: (s) => this.#timeOfDay(s)});
    });
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

  #makePlot() {
    const plot = new Plot('Signals');
    plot.onZoom = (zoom) => {
      if (!zoom) {
        this.#show(this.#span);
        return;
      }
      this.#stopAt(zoom);
      this.#placeCursors();
    };
    plot.bounds = () => [this.signals.now - SPAN_S, this.signals.now];
    plot.onMark = (s) => this.#setMark(s);
    plot.mark(this.#mark);
    return plot;
  }

  #nameOfDevice(device) {
    const row = this.store.devices.get(device);
    return row ? nameOf(row, this.devices) : device;
  }

  #name({device, key, parts}) {
    return parts ? this.#nameOfPair(...parts)
      : `${this.#nameOfDevice(device)} ${splitUnit(key)[0]}`;
  }

  /** '002 \u2212 003 Present Current': what both have in common is said once. */
  #nameOfPair(one, other) {
    const register = splitUnit(one.key)[0];
    if (one.key === other.key) {
      const [first, second] = [one, other].map(({device}) => this.#nameOfDevice(device));
      return `${first} \u2212 ${second} ${register}`;
    }
    return `${this.#name(one)} \u2212 ${
      one.device === other.device ? splitUnit(other.key)[0] : this.#name(other)}`;
  }

  /** Named by the first register, and when the time shown begins: files of two choices differ. */
  #save() {
    const {signals: {all, origin}, store} = this;
    const shown = [...all, ...this.differences];
    const names = shown.map((signal) => `${this.#name(signal)}${unitOf(signal.key)}`);
    const [from] = this.range;
    const text = store.player
      ? csvOf(shown, names, this.range, 'recording (s)', (s) => s.toFixed(6))
      : csvOf(shown, names, this.range, 'time', (s) => isoTime(s + origin));
    const begin = store.player ? `${from.toFixed(3)}s` : stamp(from + origin);
    const link = h('a', {download: fileName([store.name, this.#name(all[0]), begin], 'csv'),
      href: URL.createObjectURL(new Blob([text], {type: 'text/csv'}))});
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  }
}

/** What shares a plot: up to four registers of one unit, those of a servo next to each other. */
function groupsOf(signals, kind = '') {
  const units = new Map();
  const byDevice = (a, b) => a.device < b.device ? -1 : Number(a.device > b.device);
  for (const signal of [...signals].sort(byDevice)) {
    const [, unit] = splitUnit(signal.key);
    units.set(unit, [...units.get(unit) ?? [], signal]);
  }
  return [...units].flatMap(([unit, all]) => [0, MOST_LINES].map((from) => ({
    key: `${kind}${unit} ${from}`, unit: kind + (unit || NO_UNIT),
    some: all.slice(from, from + MOST_LINES)})))
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

/** When the next value of any of some signals is; s itself where there is none. */
function nextOf(signals, s, by) {
  const times = signals.map((one) => one.beside(s, by)).filter((time) => time !== null);
  return times.length ? by * Math.min(...times.map((time) => by * time)) : s;
}

/**
 * What is known of the values from one time to another, as a text. No mean of what was written:
 * that of rare writes is not that of the time they hold.
 */
function statisticsOf(signal, from, to, isSampled) {
  const [unit, factor] = shownIn(splitUnit(signal.key)[1]);
  const {count, rate, low, high, mean, rms, deviation} = signal.statistics(from, to);
  const text = (value) => measured(factor * value, unit);
  return [count > 0 && `${figure(rate, 2)} ${isSampled ? 'samples/s' : '/s'}`,
    low < high && `${text(low)} to ${text(high)}`,
    deviation > 0 && !signal.isWritten
      && `mean ${text(mean)}, RMS ${text(rms)}, \u03c3 ${figure(factor * deviation, 3)} of ${count}`]
    .filter(Boolean).join(', ');
}
