// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// The control table of a device: name, value, unit, age, source; and its counters below.

import {each, h, say, set} from './dom.js';
import {age, numberOf, splitUnit} from './format.js';
import {saysMore} from './store.js';
import {shownIn} from './units.js';

const CHANGED_S = 2.5;
const SOURCES = {r: 'read', w: 'written'};
const HIDDEN = new Set(['Model', 'Firmware Version', 'State', 'Fields not observed']);
const COLUMNS = ['Field', 'Value', 'Unit', 'Age', 'Source'];

export class Fields {
  /** choose(key) is called when a field is pressed, to be plotted. */
  constructor(choose) {
    this.choose = choose;
    this.onlyMoving = false;
    this.search = h('input', {type: 'search', placeholder: 'Search fields',
      ariaLabel: 'Search fields', oninput: () => this.#again()});
    this.moving = h('button', {ariaPressed: false, onclick: () => {
      this.onlyMoving = !this.onlyMoving;
      this.#again();
    }}, 'Changing only');
    this.count = h('span', {class: 'quiet'});
    this.rows = h('tbody');
    this.facts = h('tbody');
    this.none = h('p', {class: 'message', 'data-state': 'stale'});
    this.element = h('section', {class: 'panel device-fields'},
      h('div', {class: 'head'}, h('h2', {}, 'Control table'), this.count, this.search,
        h('div', {class: 'choice'}, this.moving)),
      this.none,
      h('table', {class: 'fields'}, h('caption', {class: 'unseen'}, 'Observed fields'),
        h('thead', {}, h('tr', {}, ...COLUMNS.map((text) => h('th', {scope: 'col'}, text)))),
        this.rows),
      h('p', {class: 'quiet'}, 'These are the values of the reports (publish_rate); Signals shows '
        + 'what changes in between.'),
      h('h2', {}, 'Counters'),
      h('table', {class: 'fields facts'}, h('caption', {class: 'unseen'}, 'Counters'),
        this.facts));
  }

  #again() { this.update(this.device, this.table, this.plotted, this.now); }

  update(device, table, plotted, now) {
    Object.assign(this, {device, table, plotted, now});
    set(this.moving, 'aria-pressed', this.onlyMoving);
    const words = this.search.value.toLowerCase().split(/\s+/).filter(Boolean);
    const fits = (text) => words.every((word) => text.toLowerCase().includes(word));
    const fields = table?.fields ?? [];
    const facts = (table?.facts ?? []).filter(([key]) => !HIDDEN.has(key) && fits(key));
    const shown = fields.filter((field) => fits(`${field.key} ${field.value}`)
      && (!this.onlyMoving || field.changed));
    const unseen = table?.facts.find(([key]) => key === 'Fields not observed')?.[1];
    const more = unseen && unseen !== '0' ? `, ${unseen} never observed` : '';
    say(this.count, fields.length ? `${fields.length} observed${more}` : '');
    this.#tell(shown.length);
    each(this.rows, shown, (field) => field.key, (field) => this.#make(field.key),
      (row, field) => this.#show(row, field));
    each(this.facts, facts, ([key]) => key, ([key]) => this.#make(key), (row, [key, value]) =>
      this.#show(row, {key, value, raw: '', seen: null, source: '', changed: 0}));
  }

  /** Say why there is no field. */
  #tell(count) {
    this.none.hidden = count > 0;
    say(this.none, !this.table ? 'Waiting for its control table.'
      : this.table.fields.length ? 'No field matches.'
        : `No field observed yet${saysMore(this.device) ? ''
          : ': the master has not read this device'}.`);
  }

  #make(key) {
    const [name, unit] = splitUnit(key);
    const button = h('button', {class: 'field', onclick: () => this.choose(key)},
      h('i', {class: 'swatch'}), h('span', {}, name));
    return h('tr', {}, h('th', {scope: 'row'}, button),
      h('td', {class: 'value'}, h('span'), h('small')), h('td', {class: 'unit'}, shownIn(unit)[0]),
      h('td', {class: 'age'}), h('td', {class: 'source'}));
  }

  #show(row, field) {
    const [head, value, , seen, source] = row.children;
    const button = head.firstChild;
    const line = this.plotted.indexOf(field.key);
    const isNumber = Number.isFinite(numberOf(field.raw || field.value));
    set(button, 'disabled', !isNumber);
    set(button, 'aria-pressed', isNumber ? line >= 0 : null);
    set(button, 'title', isNumber ? 'Plot' : null);
    set(button.firstChild, 'data-line', line >= 0 ? line : null);
    say(value.firstChild, shownValue(field));
    say(value.lastChild, field.raw && field.raw !== field.value ? field.raw : '');
    set(value, 'data-changed', field.changed > 0 && this.now - field.changed < CHANGED_S);
    say(seen, field.seen === null ? '' : age(this.now - field.seen));
    say(source, SOURCES[field.source] ?? '');
    set(source, 'data-source', field.source || null);
  }
}

function shownValue({key, value}) {
  const [, factor] = shownIn(splitUnit(key)[1]);
  const number = factor * numberOf(value);
  return factor === 1 || !Number.isFinite(number) ? value : String(Number(number.toFixed(3)));
}
