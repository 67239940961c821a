// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// View 3: one device: every observed field, what was missed, a plot of whatever is a number.

import {each, h, icon, say, set, setIcon} from './dom.js';
import {Fields} from './fields.js';
import {id3, path, splitUnit} from './format.js';
import {showCrumbs, showFinding} from './parts.js';
import {Plot} from './plot.js';
import {deviceName, stateOf, wordOf} from './store.js';

const LATENCY = 'Reply latency';
const MOST_SERIES = 4;
const FIRST = ['Present Position', 'Goal Position'];

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
    this.before = h('a', {class: 'button', ariaLabel: 'Device before'}, '\u2039');
    this.after = h('a', {class: 'button', ariaLabel: 'Device after'}, '\u203a');
    this.findings = h('ul', {class: 'findings'});
    this.latency = h('button', {type: 'button', class: 'button', onclick: () => this.#choose(LATENCY)}, LATENCY);
    this.plot = new Plot('Plot', 60, this.latency, h('span', {class: 'quiet hint'}, 'or press any number'));
    this.errors = h('ol', {class: 'errors'});
    this.noErrors = h('p', {class: 'quiet'}, 'None among the last 50 of this bus.');
    this.siblings = h('ul', {class: 'siblings'});
    this.element = h('div', {class: 'device-view'},
      h('nav', {class: 'beside', ariaLabel: 'Devices'}, this.siblings),
      h('div', {class: 'device-head'}, this.crumbs,
        h('div', {class: 'head'}, this.badge, this.heading, this.about, h('span', {class: 'steps'}, this.before, this.after)), this.message, this.findings),
      h('section', {class: 'panel device-plot', ariaLabel: 'Plot'}, this.plot.element),
      this.fields.element,
      h('section', {class: 'panel device-errors'}, h('h2', {}, 'Error history'), this.noErrors, this.errors));
  }

  get title() { return this.name; }

  close() { this.plot.close(); }

  up() { return this.device ? path('devices', this.group.key, this.device.model) : '#/devices'; }

  step(by) {
    const list = this.group?.devices ?? [];
    const at = list.findIndex((device) => device.name === this.name);
    return at < 0 || !list[at + by] ? null : path('device', list[at + by].name);
  }

  /** Add a field to the plot, or take it away; other units make place. */
  #choose(key) {
    const unit = splitUnit(key)[1];
    const same = (this.plotted ?? []).filter((one) => one !== LATENCY && splitUnit(one)[1] === unit);
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
    if (!device) return;
    this.plotted ??= firstPlot(table);
    this.fields.update(table, this.plotted ?? [], store.now());
    set(this.latency, 'aria-pressed', this.plotted?.includes(LATENCY) ?? false);
    this.plot.update(this.#series(table), store.now());
    each(this.findings, device.findings, ([rule]) => rule, () => h('li', {}, icon('warn'), h('b'), h('span')), showFinding);
    const own = (this.group.row?.errors ?? []).filter((line) => line.includes(` s: ${id3(device.id)}: `));
    this.noErrors.hidden = own.length > 0;
    each(this.errors, own, (line) => line, (line) => h('li', {}, line));
    each(this.siblings, this.group.devices, (one) => one.name, makeSibling, (item, one) => showSibling(item, one, this.name));
  }

  #head(device) {
    const state = stateOf(device);
    set(this.badge, 'data-state', state);
    setIcon(this.badge.firstChild, state);
    say(this.badge.lastChild, device ? wordOf(device) : 'not known');
    say(this.message, device ? sentence(device, this.store.now()) : '');
    this.message.hidden = !this.message.textContent;
    say(this.heading, device ? deviceName(device) : this.name);
    say(this.about, device ? `${device.model} \u00b7 firmware ${device.firmware || 'unknown'}${device.bus ? ` \u00b7 bus ${device.bus}` : ''}` : 'Nobody reports this device. It is shown as soon as somebody does.');
    for (const [link, by] of [[this.before, -1], [this.after, 1]]) {
      const to = this.step(by);
      set(link, 'href', to);
      set(link, 'aria-disabled', to === null);
    }
    showCrumbs(this.crumbs, device
      ? [['Overview', '#/'], [device.bus ? `bus ${device.bus}` : 'Devices', path('devices', this.group.key)], [device.model, this.up()]]
      : [['Overview', '#/'], ['Devices', '#/devices']]);
  }

  #series(table) {
    if (!table || !this.plotted) return [];
    return this.plotted.flatMap((key) => key === LATENCY
      ? [[1, 'p50'], [2, 'p95'], [3, 'max']].map(([at, name]) => ({name: `latency ${name}`, unit: 'ms', points: table.latency.map((point) => [point[0], point[at] ?? null])}))
      : [{name: splitUnit(key)[0], unit: splitUnit(key)[1], points: table.history.get(key) ?? []}]);
  }
}

/** What the badge and the findings do not say yet. */
function sentence(device, now) {
  if (device.quiet_since !== undefined) return `no report for ${Math.round(now - device.quiet_since)} s; last: ${device.message}`;
  const isSaid = device.message === device.state || device.findings.some(([, text]) => text === device.message);
  return isSaid ? '' : device.message;
}

/** What is plotted at first: position, else latency, else the first number. */
function firstPlot(table) {
  if (!table) return null;
  const keys = [...table.history.keys()];
  const named = FIRST.map((name) => keys.find((key) => splitUnit(key)[0] === name)).filter(Boolean);
  const units = new Set(named.map((key) => splitUnit(key)[1]));
  if (named.length) return units.size === 1 ? named : named.slice(0, 1);
  if (table.latency.length) return [LATENCY];
  const field = table.fields.find(({key}) => table.history.has(key));
  return field ? [field.key] : null;
}

const makeSibling = (device) => h('li', {}, h('a', {href: path('device', device.name)}, icon('ok'), h('b'), h('span')));

function showSibling(item, device, here) {
  const link = item.firstChild;
  const state = stateOf(device);
  set(link, 'data-state', state);
  set(link, 'aria-current', device.name === here ? 'page' : null);
  setIcon(link.children[0], state);
  say(link.children[1], id3(device.id));
  say(link.children[2], device.joint || device.model);
  set(link, 'aria-label', `${deviceName(device)}, ${wordOf(device)}`);
}
