// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// View 2: devices by ID: of one model, of one bus, or all; as a table of values or as cards; a
// search and a choice by state.

import {DeviceTable, ORDERS} from './table.js';
import {each, h, icon, say, sayWords, set, showState} from './dom.js';
import {id3, plural} from './format.js';
import {choice, fillEmpty, showChosen, showCrumbs} from './parts.js';
import {Pause} from './pause.js';
import {keepFilters, path} from './place.js';
import {answersOf} from './servos.js';
import {isQuiet, LEVELS, stateOf, wordOf, WORDS} from './store.js';

const FORMS = [['table', 'Table'], ['cards', 'Cards']];

export class Devices {
  wantsValues = true;

  constructor([bus, model], filters) {
    this.bus = bus;
    this.model = model;
    this.title = model ?? 'Devices';
    this.only = LEVELS.includes(filters.get('only')) ? filters.get('only') : '';
    this.form = filters.get('as') === 'cards' ? 'cards' : 'table';
    this.table = new DeviceTable(() => this.#change());
    const [order, direction] = (filters.get('by') ?? '').split('.');
    if (Object.hasOwn(ORDERS, order)) this.table.sort(order, direction === 'up');
    this.heading = h('h1', {tabindex: -1}, this.title);
    this.crumbs = h('nav', {class: 'crumbs', ariaLabel: 'Place'});
    this.search = h('input', {type: 'search', placeholder: 'ID, joint, model',
      ariaLabel: 'Search devices', oninput: () => this.#change()});
    this.search.value = filters.get('find') ?? '';
    this.chips = choice('Show only', [['', h('span', {}, 'All'), h('b')], ...LEVELS.map(
      (state) => [state, icon(state), h('span', {}, WORDS[state]), h('b')])],
    (only) => this.#change({only}));
    this.forms = choice('Show as', FORMS, (form) => this.#change({form}));
    this.pause = new Pause('Devices', () => this.update(this.store, true));
    this.empty = h('div', {class: 'empty'});
    this.none = h('p', {class: 'empty'}, 'No device matches.');
    this.lists = h('div');
    this.element = h('div', {}, this.crumbs,
      h('div', {class: 'head'}, this.heading, this.search, this.chips, this.forms,
        this.pause.element), this.empty,
      this.none, this.table.element, this.lists);
  }

  /** Show others, as somebody chose: {only} or {form}; or by what the table or the search has. */
  #change(chosen) {
    Object.assign(this, chosen);
    keepFilters({find: this.search.value, only: this.only,
      as: this.form === 'cards' ? 'cards' : '', by: this.table.order});
    this.update(this.store, true);
  }

  close() { this.table.close(); }

  /** isAsked: somebody chose what to see, which a pause does not forbid. */
  update(store, isAsked = !this.store) {
    this.store = store;
    const all = store.groups();
    const isOurs = (device) => !this.model || device.model === this.model;
    const groups = all.filter((group) => !this.bus || group.key === this.bus)
      .map((group) => ({...group, devices: group.devices.filter(isOurs)}));
    this.#place(groups, all.length);
    this.#chips(groups.flatMap((group) => group.devices));
    const words = this.search.value.toLowerCase().split(/\s+/).filter(Boolean);
    const fits = (device) => (!this.only || stateOf(device) === this.only)
      && words.every((word) => textOf(device).includes(word));
    const shown = groups.map((group) => ({...group, devices: group.devices.filter(fits)}))
      .filter((group) => group.devices.length);
    this.empty.hidden = all.some((group) => group.devices.length);
    if (!this.empty.hidden) fillEmpty(this.empty, store);
    this.none.hidden = shown.length > 0 || !this.empty.hidden;
    this.pause.element.hidden = !this.empty.hidden;
    if (isAsked || !this.pause.isOn) this.#list(shown, store);
  }

  #list(shown, store) {
    const isTable = this.form === 'table';
    showChosen(this.forms, this.form);
    this.table.element.hidden = !isTable || !shown.length;
    if (isTable) this.table.update(shown, store);
    each(this.lists, isTable ? [] : shown, (group) => group.key, makeGroup,
      (element, group) => updateGroup(element, group, shown.length > 1));
  }

  #chips(devices) {
    showChosen(this.chips, this.only);
    for (const chip of this.chips.children) {
      const state = chip.dataset.value;
      const some = state ? devices.filter((device) => stateOf(device) === state) : devices;
      say(chip.lastChild, String(some.length));
      set(chip, 'data-state', some.length && state ? state : null);
    }
  }

  #place(groups, count) {
    const label = this.bus ? groups[0]?.label ?? this.bus : '';
    const links = [['Overview', path()], ['Devices', this.bus ? path('devices') : null]];
    if (this.bus && count > 1) {
      links.push([`bus ${label}`, this.model ? path('devices', this.bus) : null]);
    }
    if (this.model) links.push([this.model, null]);
    showCrumbs(this.crumbs, links);
    say(this.heading, this.model ?? (this.bus && count > 1 ? `Bus ${label}` : 'Devices'));
  }
}

const textOf = (device) => [id3(device.id), device.id, device.joint, device.model, device.bus,
  device.state, device.message].join(' ').toLowerCase();

function makeGroup() {
  return h('section', {}, h('h2', {class: 'group'}), h('ul', {class: 'grid'}));
}

function updateGroup(element, group, several) {
  const [heading, grid] = element.children;
  heading.hidden = !several;
  say(heading, `Bus ${group.label}, ${plural(group.devices.length, 'device')}`);
  each(grid, group.devices, (device) => device.name, makeDevice, updateDevice);
}

function makeDevice(device) {
  return h('li', {}, h('a', {class: 'device', href: path('device', device.name)},
    icon('ok'), h('b', {class: 'device-id'}), h('span', {class: 'device-joint'}),
    h('span', {class: 'device-text'}), h('span', {class: 'device-figures'})));
}

function updateDevice(item, device) {
  const [, id, joint, text, figures] = item.firstChild.children;
  const state = stateOf(device);
  showState(item.firstChild, state);
  say(id, id3(device.id));
  say(joint, device.joint || device.model);
  const isOld = isQuiet(device);
  sayWords(text, isOld ? wordOf(device) : device.message);
  say(figures, isOld ? '' : answersOf(device));
}
