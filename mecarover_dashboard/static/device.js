// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// View 3: one device: every observed field, what was missed, a plot of any field that is a number.

import {each, h, icon, say, sayWords, set, showState} from './dom.js';
import {ErrorList, errorsOf} from './errors.js';
import {Fields} from './fields.js';
import {id3, numberOf, splitUnit} from './format.js';
import {makeFinding, showFinding, wasTrue} from './findings.js';
import {showCrumbs} from './parts.js';
import {path} from './place.js';
import {HistoryPanel} from './history_panel.js';
import {Plot} from './plot.js';
import {pathOfSignals} from './signals.js';
import {deviceName, isQuiet, saysMore, stateOf, wordOf} from './store.js';

const LATENCY = 'Reply latency';
const MOST_SERIES = 4;
const FIRST = ['Present Position', 'Goal Position'];
const LIMITS = new Map(Object.entries({
  'Present Temperature': ['Temperature Limit'],
  'Present Input Voltage': ['Min Voltage Limit', 'Max Voltage Limit'],
  'Present Voltage': ['Min Voltage Limit', 'Max Voltage Limit'],
  'Present Position': ['Min Position Limit', 'Max Position Limit'],
  'Present Current': ['Current Limit'], 'Present Velocity': ['Velocity Limit'],
}));

export class DeviceView {
  constructor([name]) {
    this.name = name;
    this.watch = name;
    this.plotted = null;
    this.fields = new Fields((key) => this.#choose(key));
    this.crumbs = h('nav', {class: 'crumbs', ariaLabel: 'Place'});
    this.heading = h('h1', {tabindex: -1}, name);
    this.badge = h('p', {class: 'badge'}, icon('stale'), h('span'));
    this.about = h('p', {class: 'about'});
    this.message = h('p', {class: 'message'});
    this.before = h('a', {class: 'button', ariaLabel: 'Previous device'}, '\u2039');
    this.after = h('a', {class: 'button', ariaLabel: 'Next device'}, '\u203a');
    this.findings = h('ul', {class: 'findings'});
    this.latency = h('button', {class: 'button',
      onclick: () => this.#choose(LATENCY)}, LATENCY);
    this.plot = new Plot('Plot', 60, this.latency,
      this.fast = h('a', {class: 'button'}, 'Signals'),
      h('span', {class: 'quiet hint'}, 'or click any number; drag to zoom'));
    this.siblings = h('ul', {class: 'siblings'});
    this.panel = new HistoryPanel(name);
    this.errors = new ErrorList('Error history', this.panel.pause,
      {empty: 'None in the last 50 errors of this bus.', ofOne: true});
    this.errors.head.append(this.panel.pause.element);
    this.element = this.#lay();
  }

  #lay() {
    const head = h('div', {class: 'head'}, this.badge, this.heading, this.about,
      h('span', {class: 'steps'}, this.before, this.after));
    this.errors.element.classList.add('device-errors');
    return h('div', {class: 'device-view'},
      h('nav', {class: 'beside', ariaLabel: 'Devices'}, this.siblings),
      h('div', {class: 'device-head'}, this.crumbs, head, this.message, this.findings),
      this.fields.element,
      h('section', {class: 'panel device-plot', ariaLabel: 'Plot'}, this.plot.element),
      this.errors.element,
      h('section', {class: 'panel device-past'},
        h('h2', {}, h('a', {class: 'more', href: path('history', this.name)}, 'History')),
        this.panel.element));
  }

  get title() { return this.name; }

  close() {
    this.plot.close();
    this.panel.close();
  }

  up() {
    return this.device ? path('devices', this.group.key, this.device.model) : path('devices');
  }

  step(by) {
    const list = this.group?.devices ?? [];
    const at = list.findIndex((device) => device.name === this.name);
    return at < 0 || !list[at + by] ? null : path('device', list[at + by].name);
  }

  /** Add a field to the plot, or take it away; other units make place. */
  #choose(key) {
    const unit = splitUnit(key)[1];
    const same = (this.plotted ?? []).filter((one) =>
      one !== LATENCY && splitUnit(one)[1] === unit);
    if (key === LATENCY) this.plotted = [LATENCY];
    else if (same.includes(key)) this.plotted = same.filter((one) => one !== key);
    else this.plotted = [...same, key].slice(-MOST_SERIES);
    this.update(this.store);
  }

  update(store) {
    this.store = store;
    const device = this.device = store.devices.get(this.name);
    this.group = store.groups().find((group) => group.devices.includes(device));
    const table = store.table?.name === this.name ? store.table : null;
    this.#head(device);
    this.panel.update(store);
    if (!device) return;
    this.plotted ??= firstPlot(table);
    set(this.fields.element, 'data-old', !device.live);
    this.fields.update(device, table, this.plotted ?? [], store.now());
    set(this.latency, 'aria-pressed', this.plotted?.includes(LATENCY) ?? false);
    set(this.fast, 'href', pathOfSignals(this.name,
      (this.plotted ?? []).filter((key) => key !== LATENCY)));
    this.plot.update(this.#series(table), store.now(),
      {limits: limitsOf(table, this.plotted ?? [])});
    each(this.findings, device.findings, ([rule]) => rule, () => makeFinding('warn'),
      (item, finding) => showFinding(item, finding, wasTrue(device, this.group.part, store)));
    this.errors.update(errorsOf([this.group], store).filter((one) => one.device === device));
    each(this.siblings, this.group.devices, (one) => one.name, makeSibling,
      (item, one) => showSibling(item, one, this.name));
  }

  #head(device) {
    const state = stateOf(device);
    showState(this.badge, state);
    say(this.badge.lastChild, device ? wordOf(device) : 'not known');
    sayWords(this.message, device ? sentence(device, this.store.now()) : '');
    set(this.message, 'data-state', state === 'ok' ? null : state);
    this.message.hidden = !this.message.textContent;
    say(this.heading, device ? deviceName(device) : this.name);
    say(this.about, device ? aboutOf(device)
      : 'No node reports this device. It appears here as soon as a node does.');
    for (const [link, by] of [[this.before, -1], [this.after, 1]]) {
      const to = this.step(by);
      set(link, 'href', to);
      set(link, 'aria-disabled', to === null);
    }
    showCrumbs(this.crumbs, device
      ? [['Overview', path()],
        [device.bus ? `bus ${device.bus}` : 'Devices', path('devices', this.group.key)],
        [device.model, this.up()]]
      : [['Overview', path()], ['Devices', path('devices')]]);
  }

  #series(table) {
    if (!table || !this.plotted) return [];
    return this.plotted.flatMap((key) => {
      const [name, unit] = splitUnit(key);
      return key === LATENCY ? latencySeries(table.latency)
        : [{name, unit, points: table.history.get(key) ?? []}];
    });
  }
}

const latencySeries = (points) => [[1, 'p50'], [2, 'p95'], [3, 'max']].map(([at, name]) => ({
  name: `latency ${name}`, unit: 'ms',
  points: points.map((point) => [point[0], point[at] ?? null])}));

function aboutOf({model, firmware, bus}) {
  return [model, `firmware ${firmware || 'unknown'}`, ...bus ? [`bus ${bus}`] : []]
    .join(' \u00b7 ');
}

/** What the badge and the findings do not say yet. */
function sentence(device, now) {
  const isSaid = device.findings.some(([, text]) => text === device.message);
  if (!isQuiet(device)) return isSaid || !saysMore(device) ? '' : device.message;
  return `no report for ${Math.round(now - device.quiet_since)} s`
    + (isSaid ? '' : `; last: ${device.message}`);
}

/** What is plotted at first: position, else latency, else the first number. */
function firstPlot(table) {
  if (!table) return null;
  const keys = [...table.history.keys()];
  const named = FIRST.map((name) => keys.find((key) => splitUnit(key)[0] === name))
    .filter(Boolean);
  const units = new Set(named.map((key) => splitUnit(key)[1]));
  if (named.length) return units.size === 1 ? named : named.slice(0, 1);
  if (table.latency.some((point) => Number.isFinite(point[1]))) return [LATENCY];
  const field = table.fields.find(({key}) => table.history.has(key));
  return field ? [field.key] : null;
}

/** The limits of what is plotted, as the device says them: [[name, value], ...]. */
function limitsOf(table, plotted) {
  return plotted.flatMap((key) => {
    const [name, unit] = splitUnit(key);
    const wanted = LIMITS.get(name) ?? [];
    return (table?.fields ?? []).filter((field) => wanted.includes(splitUnit(field.key)[0])
      && splitUnit(field.key)[1] === unit && Number.isFinite(numberOf(field.value)))
      .map((field) => [splitUnit(field.key)[0], numberOf(field.value)]);
  });
}

const makeSibling = (device) =>
  h('li', {}, h('a', {href: path('device', device.name)}, icon('ok'), h('b'), h('span')));

function showSibling(item, device, here) {
  const link = item.firstChild;
  const state = stateOf(device);
  showState(link, state);
  set(link, 'aria-current', device.name === here ? 'page' : null);
  say(link.children[1], id3(device.id));
  say(link.children[2], device.joint || device.model);
  set(link, 'title', wordOf(device));
}
