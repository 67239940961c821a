// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// View 1: per bus a bar that tells the worst, a cell per device, what needs a look, a tile per model.

import {Beside} from './beside.js';
import {each, h, icon, say, set, setIcon} from './dom.js';
import {id3, list, path, plural, short} from './format.js';
import {fillEmpty} from './parts.js';
import {deviceName, isLost, stateOf, valueOf, WORDS} from './store.js';

const MOST_ALERTS = 8;

export class Overview {
  constructor() {
    this.title = 'Overview';
    this.empty = h('div', {class: 'empty'});
    this.buses = h('div', {class: 'buses'});
    this.beside = new Beside();
    this.element = h('div', {}, h('h1', {class: 'unseen', tabindex: -1}, 'Overview'), this.empty,
      h('div', {class: 'overview'}, h('div', {class: 'buses'}, this.buses, this.beside.below), this.beside.element));
  }

  close() { this.beside.close(); }

  update(store) {
    const groups = store.groups();
    this.empty.hidden = groups.length > 0;
    if (!groups.length) fillEmpty(this.empty, store);
    each(this.buses, groups, (group) => group.key, makeBus, updateBus);
    this.beside.update(store, groups);
  }
}

function makeBus(group) {
  const devices = path('devices', group.key);
  return h('section', {class: 'bus'},
    h('a', {class: 'bar', href: devices}, icon('ok'), h('b', {class: 'bar-count'}), h('span', {class: 'bar-text'}), h('span', {class: 'bar-sum'}), h('span', {class: 'bar-bus'})),
    h('div', {class: 'strip', 'aria-hidden': 'true'}),
    h('ul', {class: 'alerts'}),
    h('div', {class: 'tiles'}),
    h('p', {class: 'bus-line'}));
}

function updateBus(element, group) {
  const [bar, strip, alerts, tiles, line] = element.children;
  set(bar, 'data-state', group.state);
  setIcon(bar.children[0], group.state);
  say(bar.children[1], `${group.there}/${group.devices.length}`);
  say(bar.children[2], group.headline);
  say(bar.children[3], sums(group));
  say(bar.children[4], group.bus ? `bus ${group.bus}` : '');
  set(bar, 'aria-label', `${group.label}: ${group.there} of ${plural(group.devices.length, 'device')} connected. ${group.headline}. Show devices`);
  set(strip, 'data-many', group.devices.length > 60);
  each(strip, group.devices, (device) => device.name, () => h('i', {class: 'cell'}), updateCell);
  each(alerts, alertsOf(group), (alert) => alert.key, makeAlert, updateAlert);
  each(tiles, group.models, (model) => model.model, (model) => makeTile(group, model), updateTile);
  say(line, busLine(group));
}

/** '2 lost, 1 silent, 1 warning'; nothing where the headline says it all. */
function sums({devices, lost}) {
  const count = (state) => devices.filter((device) => stateOf(device) === state).length;
  const parts = [[lost.length, 'lost'], [count('error') - lost.length, 'error'], [count('stale'), 'silent'], [count('warn'), 'warning']]
    .filter(([number]) => number);
  return parts.length > 1 ? parts.map(([number, word]) => `${number} ${word}`).join(' \u00b7 ') : '';
}

const RANK = {error: 0, stale: 1, warn: 2, ok: 3};
const byUrgency = (a, b) => RANK[stateOf(a)] - RANK[stateOf(b)] || a.id - b.id;

function updateCell(cell, device) {
  set(cell, 'data-state', stateOf(device));
  say(cell, String(device.id));
}

/** Who needs a look: [{key, state, names, message, href}]; devices that say the same share one. */
function alertsOf(group) {
  const found = new Map();
  for (const device of group.devices.filter((one) => stateOf(one) !== 'ok').sort(byUrgency)) {
    const message = device.quiet_since === undefined ? device.message : 'no report';
    const key = `${stateOf(device)} ${message}`;
    if (!found.has(key)) found.set(key, {state: stateOf(device), message, devices: []});
    found.get(key).devices.push(device);
  }
  const alerts = [...found.values()].map(({state, message, devices}) => {
    const [first] = devices;
    return {state, message, key: `${first.name} ${devices.length > 1}`, names: list(devices.map(devices.length > 1 ? ({id}) => id3(id) : deviceName)),
      href: devices.length > 1 ? path('devices', group.key) : path('device', first.name)};
  });
  if (alerts.length <= MOST_ALERTS) return alerts;
  const more = {state: 'ok', message: 'see all devices', key: '', names: `${alerts.length - MOST_ALERTS + 1} more`, href: path('devices', group.key)};
  return [...alerts.slice(0, MOST_ALERTS - 1), more];
}

const makeAlert = ({href}) => h('li', {}, h('a', {class: 'alert', href}, icon('warn'), h('p', {}, h('b'), ' ', h('span'))));

function updateAlert(item, alert) {
  const [symbol, text] = item.firstChild.children;
  set(item.firstChild, 'data-state', alert.state);
  setIcon(symbol, alert.state);
  say(text.firstChild, alert.names);
  say(text.lastChild, alert.message);
}

function makeTile(group, model) {
  return h('a', {class: 'tile', href: path('devices', group.key, model.model)},
    h('span', {class: 'tile-name'}, model.model), icon('ok'),
    h('b', {class: 'tile-count'}), h('span', {class: 'tile-of'}), h('span', {class: 'tile-text'}));
}

function updateTile(tile, model) {
  const lost = model.devices.filter(isLost).length;
  set(tile, 'data-state', model.state);
  setIcon(tile.children[1], model.state);
  say(tile.children[2], String(model.there));
  say(tile.children[3], `of ${model.devices.length}`);
  say(tile.children[4], lost ? `${lost} lost` : model.state === 'ok' ? 'connected' : WORDS[model.state].toLowerCase());
}

function busLine(group) {
  const {row} = group;
  if (!row) return '';
  const rate = (key, unit) => valueOf(row, key) ? `${short(valueOf(row, key), 3)} ${unit}` : null;
  return [valueOf(row, 'Port'), rate('Baud (bit/s)', 'Bd'), rate('packets (1/s)', 'packets/s'), rate('errors (1/s)', 'errors/s')]
    .filter(Boolean).join('  \u00b7  ');
}
