// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// Devices as a table of values: the worst first, or by any column.

import {each, h, icon, say, sayWords, set, showState} from './dom.js';
import {FIGURES} from './figures.js';
import {id3, isolate, numberOf, short} from './format.js';
import {path} from './place.js';
import {byUrgency, isQuiet, stateOf, wordOf} from './store.js';
import {positionText} from './units.js';

const figureOf = (text) => {
  const value = numberOf(text ?? '');
  return Number.isFinite(value) ? value : null;
};

// A column: name (and class), heading, its content, its sort key (null: unknown).
const COLUMNS = [
  ['state', 'State', (device) => wordOf(device), null],
  ['id', 'Device', null, (device) => device.id],
  ['model', 'Model', (device) => device.model, (device) => device.model],
  ['position', 'Position', (_, {position, positionUnit}) => positionText(position, positionUnit),
    (_, {position}) => figureOf(position)],
  ['temperature', '\u00b0C', (_, {temperature}) => temperature,
    (_, {temperature}) => figureOf(temperature)],
  ['voltage', 'V', (_, {voltage}) => voltage, (_, {voltage}) => figureOf(voltage)],
  ['load', 'Load', (_, {load, loadUnit}) => load && `${load} ${loadUnit}`,
    (_, {load}) => load ? Math.abs(figureOf(load)) : null],
  ...FIGURES.map(({name, heading, digits}) => [`${name} figure`, heading,
    (device) => isQuiet(device) ? '' : short(device[name], digits),
    (device) => figureOf(device[name])]),
];
const nameOf = (column) => column[0].split(' ')[0];
export const ORDERS = Object.fromEntries(COLUMNS.map((one) => [nameOf(one), one[3]]));
const CALM_S = 0.95;
const TITLES = {...Object.fromEntries(FIGURES.map(({name, title}) => [name, title])),
  temperature: 'Temperature (\u00b0C)', voltage: 'Voltage (V)',
  load: 'Load, or current, whichever the model has'};

export class DeviceTable {
  #by = 'state';
  #isUp = false;
  #drawn = -Infinity;          // when, s of the page
  #states = '';

  /** changed() is called when a heading was pressed. */
  constructor(changed) {
    this.heads = COLUMNS.map((one) => {
      const [name, text] = [nameOf(one), one[1]];
      return h('th', {scope: 'col', class: one[0]},
        h('button', {class: 'sort', title: TITLES[name] ?? null,
          onclick: () => {
            this.sort(name, name === this.#by && !this.#isUp);
            changed();
          }}, text));
    });
    this.rows = h('tbody');
    this.seen = new IntersectionObserver((rows) => rows.forEach(noteSeen), {rootMargin: '200px'});
    this.element = h('table', {class: 'devices panel'},
      h('caption', {class: 'unseen'}, 'Devices and their values'),
      h('thead', {}, h('tr', {}, ...this.heads)), this.rows);
    this.sort('state', false);
  }

  /** What the table is sorted by, as the address says it. */
  get order() {
    const isUsual = this.#by === 'state' && !this.#isUp;
    return isUsual ? '' : `${this.#by}${this.#isUp ? '.up' : ''}`;
  }

  /** Sort by a column: the largest first, names and IDs the smallest first; isUp turns it. */
  sort(by, isUp) {
    this.#by = by;
    this.#isUp = isUp;
    this.#drawn = -Infinity;
    this.heads.forEach((head, at) => set(head, 'aria-sort', nameOf(COLUMNS[at]) !== by ? null
      : isUp ? 'ascending' : 'descending'));
  }

  update(groups, store) {
    const devices = groups.flatMap((group) =>
      group.devices.map((device) => ({device, bus: groups.length > 1 ? group.label : '',
        values: store.valuesOf(device)})));
    if (!this.#isDue(devices)) return;
    each(this.rows, devices.sort((a, b) => this.#compare(a, b)), ({device}) => device.name,
      (one) => this.#make(one), updateIfSeen);
  }

  #make(one) {
    const row = makeRow(one);
    updateRow(row, one);
    this.seen.observe(row);
    return row;
  }

  close() { this.seen.disconnect(); }

  /** Values are written once a second, a change of state or of what is listed at once. */
  #isDue(devices) {
    const now = performance.now() / 1000;
    const states = devices.map(({device}) => device.name + stateOf(device)).join();
    if (states === this.#states && now - this.#drawn < CALM_S) return false;
    this.#states = states;
    this.#drawn = now;
    return true;
  }

  #compare(a, b) {
    const turn = this.#isUp ? -1 : 1;
    const by = ORDERS[this.#by];
    if (!by) return turn * byUrgency(a.device, b.device);
    const [x, y] = [by(a.device, a.values), by(b.device, b.values)];
    if (x === y) return byUrgency(a.device, b.device);
    if (x === null || y === null) return x === null ? 1 : -1;       // what is unknown goes last
    const isFirst = this.#by === 'id' || this.#by === 'model' ? x < y : x > y;
    return turn * (isFirst ? -1 : 1);
  }
}

function makeRow({device}) {
  return h('tr', {}, ...COLUMNS.map(([name]) =>
    name === 'id' ? h('th', {scope: 'row', class: name},
      h('a', {href: path('device', device.name)}, h('b'), h('span')))
      : name === 'state' ? h('td', {class: name}, h('p', {}, icon('ok'), h('span')))
        : h('td', {class: name})));
}

/** A row out of sight is written when it comes into sight: 253 of them cost the page a third. */
function updateIfSeen(row, one) {
  row.newest = one;
  if (row.isSeen) updateRow(row, one);
}

function noteSeen({target, isIntersecting}) {
  target.isSeen = isIntersecting;
  if (isIntersecting && target.newest) updateRow(target, target.newest);
}

function updateRow(row, {device, bus, values}) {
  const state = stateOf(device);
  set(row, 'data-state', state);
  COLUMNS.forEach(([name, , text], at) => {
    const cell = row.children[at];
    if (name === 'state') {
      showState(cell.firstChild, state);
      sayWords(cell.firstChild.lastChild, isQuiet(device) ? wordOf(device) : device.message);
    } else if (name === 'id') {
      say(cell.firstChild.firstChild, id3(device.id));
      say(cell.firstChild.lastChild, isolate(device.joint) + (bus ? ` (${bus})` : ''));
    } else {
      say(cell, text(device, values) || '\u2013');
    }
  });
  set(row, 'data-old', !device.live);
}
