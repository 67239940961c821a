// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// View 6: what happened: events of the whole robot, or values and events of one device or bus.

import {h} from './dom.js';
import {showCrumbs} from './parts.js';
import {HistoryPanel} from './history_panel.js';
import {keepFilters, path} from './place.js';

export class HistoryView {
  constructor([name], filters) {
    this.name = name ?? null;
    this.title = 'History';
    const number = (key) => filters.has(key) && Number(filters.get(key)) > 0
      ? Number(filters.get(key)) : undefined;
    const [from, to] = [number('from'), number('to')];
    const time = from && to ? {from, to} : {from: number('last') ?? (name ? 3600 : 28800)};
    this.panel = new HistoryPanel(this.name, {...time, kind: filters.get('kind') ?? ''},
      () => this.#keep());
    this.crumbs = h('nav', {class: 'crumbs', ariaLabel: 'Place'});
    this.element = h('div', {}, this.crumbs,
      h('h1', {tabindex: -1}, name ? name.replace(/^.*?: /, '') : 'History'),
      h('section', {class: 'panel'}, this.panel.element));
  }

  #keep() {
    const {from, to, kind} = this.panel;
    keepFilters(to === null ? {last: String(from), kind}
      : {from: String(from), to: String(to), kind});
  }

  close() { this.panel.close(); }

  update(store) {
    showCrumbs(this.crumbs, [['Overview', path()],
      ['History', this.name ? path('history') : null], ...this.name ? [[this.name, null]] : []]);
    this.panel.update(store);
  }
}
