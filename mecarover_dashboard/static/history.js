// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// View 6: what happened: events of the whole robot, or values and events of one device or bus.

import {h} from './dom.js';
import {showCrumbs} from './parts.js';
import {HistoryPanel} from './history_panel.js';
import {keepFilters, path} from './place.js';

const AROUND_S = 1800;         // what a link with only one time shows before and after it

export class HistoryView {
  constructor([name], filters) {
    this.name = name ?? null;
    this.title = 'History';
    const get = (key) => filters.get(key) ?? '';
    const at = Number(get('at')) || null;
    const around = at && !get('from') && {from: String(at - AROUND_S), to: String(at + AROUND_S)};
    const usual = get('last') ? `-${get('last')} s` : name ? '-1 h' : '-8 h';
    this.panel = new HistoryPanel(this.name, {from: get('from') || usual, to: get('to'), ...around,
      at, kind: get('kind'), others: filters.getAll('with')}, () => this.#keep());
    this.crumbs = h('nav', {class: 'crumbs', ariaLabel: 'Place'});
    this.element = h('div', {}, this.crumbs,
      h('h1', {tabindex: -1}, name ? name.replace(/^.*?: /, '') : 'History'),
      h('section', {class: 'panel'}, this.panel.element));
  }

  #keep() {
    const {from, to, at, kind, others} = this.panel;
    keepFilters([['from', from], ['to', to], ['at', at && String(Math.round(at))], ['kind', kind],
      ...others.map((name) => ['with', name])]);
  }

  close() { this.panel.close(); }

  update(store) {
    const [, query] = location.hash.split('?');         // the same time, of the whole robot
    showCrumbs(this.crumbs, [['Overview', path()], ['History', this.name
      ? path('history') + (query ? `?${query}` : '') : null], ...this.name ? [[this.name, null]] : []]);
    this.panel.update(store);
  }
}
