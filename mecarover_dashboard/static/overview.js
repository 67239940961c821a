// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// View 1: a bar with the worst state of the bridge and of each bus, a cell per device, the devices
// with a problem, a tile per model.

import {OverviewSidebar} from './overview_sidebar.js';
import {each, h, icon, say, sayWords, set, showState} from './dom.js';
import {makeRemedy, showRemedy} from './finding.js';
import {id3, isolate, list, short} from './format.js';
import {path} from './place.js';
import {fillEmpty} from './parts.js';
import {Pause} from './pause.js';
import {showServos, sizeOf} from './servos.js';
import {byUrgency, cardStateOf, countOf, deviceName, isLost, isQuiet, stateOf, valueOf, WORDS, worst,
  worstFirst} from './store.js';

const CUT = 'broken_cable';      // what is after it is lost with it
const MOST_ALERTS = 8;

export class Overview {
  wantsValues = true;

  constructor() {
    this.title = 'Overview';
    this.empty = h('div', {class: 'empty'});
    this.bridge = h('section', {class: 'bus'}, makeBar(path('bridge')));
    this.buses = h('div', {class: 'buses'});
    this.pause = new Pause('Devices, findings and errors', () => this.update(this.store));
    this.sidebar = new OverviewSidebar(this.pause);
    this.element = h('div', {}, h('h1', {class: 'unseen', tabindex: -1}, 'Overview'), this.empty,
      h('div', {class: 'overview'},
        h('div', {class: 'buses'}, this.bridge, this.buses), this.sidebar.element,
        this.sidebar.below));
  }

  close() { this.sidebar.close(); }

  update(store) {
    this.store = store;
    const groups = store.groups();
    const bridge = store.bridgePart();
    this.empty.hidden = groups.length > 0;
    if (!groups.length) fillEmpty(this.empty, store);
    this.bridge.hidden = !bridge;
    if (bridge) showBridge(this.bridge, bridge, store.said(bridge));
    const isFirst = store.parts()[0]?.bus === null;       // the worst comes first
    this.buses.style.order = isFirst ? '' : -1;
    const shown = groups.map((group) => ({...group, alerts: alertsOf(group),
      text: store.said(group.part)}));
    each(this.buses, shown, (group) => group.key, makeBus,
      (element, group) => updateBus(element, group, store, this.pause.isOn));
    const line = this.buses.lastElementChild?.lastElementChild;
    if (line && line !== this.pause.element.parentElement) line.append(this.pause.element);
    this.sidebar.update(store, shown);
  }
}

const makeBar = (href) => h('a', {class: 'bar', href}, icon('ok'), h('span', {class: 'bar-text'}),
  h('span', {class: 'bar-bus'}), h('b', {class: 'bar-count'}), h('span', {class: 'bar-of'}),
  h('span', {class: 'unseen'}));

function showBridge(element, {state, is_known: isKnown}, text) {
  const bar = element.firstChild;
  set(element, 'data-state', state);
  showState(bar, state);
  set(bar, 'data-known', String(isKnown));
  set(bar, 'data-bridge', true);
  sayWords(bar.children[1], text);
  say(bar.children[2], 'Bridge');
  say(bar.lastChild, WORDS[state]);
}

const makeBus = (group) => h('section', {class: 'bus'}, makeBar(path('devices', group.key)),
  h('p', {class: 'remedies'}),
  h('div', {class: 'strip', 'aria-hidden': 'true'}),
  h('ul', {class: 'servos'}),
  h('ul', {class: 'alerts'}),
  h('div', {class: 'tiles'}),
  h('div', {class: 'bus-line'}, h('p')));

function updateBus(element, group, store, isPaused) {
  const [bar, remedies, strip, , , tiles, line] = element.children;
  const total = group.devices.length;
  const {is_known: isKnown} = group.part;
  showState(bar, group.state);
  set(bar, 'data-known', String(isKnown));
  sayWords(bar.children[1], group.text);
  say(bar.children[2], group.bus ? `Bus ${group.bus}` : '');
  say(bar.children[3], `${countOf(group.devices, group.part)} of ${total}`);
  say(bar.children[4], ` ${total === 1 ? 'device answers' : 'devices answer'}`);
  say(bar.lastChild, `. ${WORDS[group.state]}`);
  each(remedies, rulesOf(group), (rule) => rule, makeRemedy, (button, rule) => {
    showRemedy(button, rule);
    say(button, button.ariaLabel);
  });
  set(strip, 'data-many', total > 60);
  each(strip, group.devices, (device) => device.name, makeCell, updateCell);
  set(element, 'data-size', sizeOf(total));
  if (!isPaused) showDevices(element, group, store);
  each(tiles, group.models, (model) => model.model, (model) => makeTile(group, model),
    updateTile);
  say(line.firstChild, busLine(group));
  set(tiles, 'data-old', !isKnown);
  set(line, 'data-old', !isKnown);
}

/** The rules of what the bar and the cards say, those of errors first. */
function rulesOf({row, devices, part, text}) {
  const shown = [...(row?.findings ?? []).filter((one) => text.includes(one[1])),
    ...devices.flatMap(({findings, message}) => findings.filter((one) => one[1] === message))];
  return !part.is_known ? [] : shown.filter((one) => one[2] !== 'ok')
    .sort((a, b) => worstFirst(a[2], b[2])).map(([rule]) => rule);
}

/** ['2 lost', '1 silent', '1 warning']: how many of some devices have which problem. */
function problemsOf(devices) {
  const found = {lost: 0, error: 0, waiting: 0, silent: 0, warning: 0, ok: 0};
  for (const device of devices) {
    const word = WORDS[stateOf(device)].toLowerCase();
    const isWaiting = word === 'warning' && device.state === 'waiting';
    found[isLost(device) ? 'lost' : isWaiting ? 'waiting' : word]++;
  }
  return Object.entries(found).filter(([word, number]) => number > 0 && word !== 'ok')
    .map(([word, number]) => `${number} ${word}`);
}

// The table of devices and the list of alerts reach the same places by key.
const makeCell = (device) =>
  h('a', {class: 'cell', tabindex: -1, href: path('device', device.name)});

function updateCell(cell, device) {
  set(cell, 'data-state', cardStateOf(device));
  set(cell, 'title', deviceName(device));
  say(cell, String(device.id));
}

/** Devices with a problem: [{key, state, names, message, href}]; equal messages share one. */
function alertsOf(group) {
  const found = new Map();
  const cut = group.devices.find(({findings}) => findings.some(([rule]) => rule === CUT));
  for (const device of group.devices.filter((one) => stateOf(one) !== 'ok').sort(byUrgency)) {
    const isCut = Boolean(cut) && isLost(device) && !device.findings.length;
    const message = isQuiet(device) ? 'no report'
      : isCut ? `silent too, after the broken cable: see ${id3(cut.id)}` : device.message;
    const key = `${stateOf(device)} ${message}`;
    if (!found.has(key)) found.set(key, {state: stateOf(device), message, isCut, devices: []});
    found.get(key).devices.push(device);
  }
  const all = [...found.values()];
  if (all.length <= MOST_ALERTS) return all.map((alert) => alertOf(group, alert));
  const hidden = all.slice(MOST_ALERTS - 1);
  const count = hidden.flatMap(({devices}) => devices).length;
  return [...all.slice(0, MOST_ALERTS - 1).map((alert) => alertOf(group, alert)),
    {state: worst(hidden.map(({state}) => state)), message: 'show all devices', key: '',
      names: `${count} more`, href: path('devices', group.key)}];
}

function alertOf(group, {state, message, isCut, devices}) {
  const [first] = devices;
  const isMany = devices.length > 1;
  return {state, message: isolate(message), key: `${first.name} ${isMany}`, devices,
    isShared: isCut || (isMany && (state !== 'error' || !group.part.live)),
    names: list(devices.map(isMany ? ({id}) => id3(id) : deviceName), group.devices.length),
    href: isMany ? path('devices', group.key) : path('device', first.name)};
}

function showDevices({children: [, , , servos, list]}, group, store) {
  // What several devices say that wait is said once, below the cards; an error on its first card.
  const texts = new Map(group.alerts.flatMap(({isShared, devices = []}) => isShared
    ? devices.map((one) => [one, ''])
    : devices.slice(1).map((one) => [one, `as ${id3(devices[0].id)}`])));
  showServos(servos, group.devices.filter((one) => one.live || texts.get(one) !== '')
    .sort(byUrgency), store, texts);
  set(servos, 'data-old', !group.part.is_known);
  list.hidden = !group.alerts.length;
  each(list, group.alerts, (alert) => alert.key, makeAlert, updateAlert);
}

const makeAlert = ({href}) => h('li', {},
  h('a', {class: 'alert', href}, icon('warn'), h('p', {}, h('b'), ' ', h('span'))));

function updateAlert(item, alert) {
  set(item, 'data-shared', String(alert.isShared ?? true));
  const text = item.firstChild.lastChild;
  showState(item.firstChild, alert.state);
  say(text.firstChild, alert.names);
  sayWords(text.lastChild, alert.message);
}

function makeTile(group, model) {
  return h('a', {class: 'tile', href: path('devices', group.key, model.model)},
    h('span', {class: 'tile-name'}, model.model), icon('ok'),
    h('b', {class: 'tile-count'}), h('span', {class: 'tile-of'}), h('span', {class: 'tile-text'}));
}

function updateTile(tile, model) {
  const {devices, part} = model;
  const state = part.is_known ? model.state : 'stale';
  showState(tile, state, tile.children[1]);
  say(tile.children[2], countOf(devices, part));
  const problems = problemsOf(devices).join(' \u00b7 ');
  const isSick = part.is_known && problems !== '';
  say(tile.children[3], `of ${devices.length}${isSick ? ' connected' : ''}`);
  say(tile.children[4], !part.is_known ? 'not known' : problems || 'connected');
}

/** Port and rates; what is not heard now has no rates, and none of 0 denies what is wrong. */
function busLine({row, part, state}) {
  if (!row) return '';
  const rate = (key, unit) => {
    const value = valueOf(row, key);
    return value && (value !== '0' || state === 'ok') ? `${short(value, 3)} ${unit}` : null;
  };
  return [valueOf(row, 'Port'), rate('Baud (bit/s)', 'Bd'),
    part.is_known && rate('packets (1/s)', 'packets/s'),
    part.is_known && rate('errors (1/s)', 'errors/s')].filter(Boolean).join('  \u00b7  ');
}
