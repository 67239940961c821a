// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// Around the buses of the overview: the bridge at a glance, what was found, load, latest errors.

import {Command} from './command.js';
import {bridgeState} from './bridge.js';
import {each, h, icon, set, setIcon} from './dom.js';
import {showFindings} from './parts.js';
import {Plot} from './plot.js';

const MOST_ERRORS = 6;

export class Beside {
  constructor() {
    this.plot = new Plot('Bus load', 300);
    this.command = new Command();
    this.symbol = icon('ok');
    this.bridge = h('section', {class: 'panel'}, h('h2', {}, h('a', {class: 'more', href: '#/bridge'}, this.symbol, 'Bridge')), this.command.element);
    this.load = h('section', {class: 'panel low'}, h('h2', {}, h('a', {class: 'more', href: '#/log'}, 'Bus load')), this.plot.element);
    this.findings = h('ul', {class: 'findings'});
    this.found = h('section', {class: 'panel'}, h('h2', {}, h('a', {class: 'more', href: '#/log'}, 'Findings')), this.findings);
    this.errors = h('ol', {class: 'errors'});
    this.failed = h('section', {class: 'panel'}, h('h2', {}, h('a', {class: 'more', href: '#/log'}, 'Last errors')), this.errors);
    this.element = h('div', {class: 'aside'}, this.bridge, this.found);
    this.below = h('div', {class: 'below'}, this.load, this.failed);
  }

  close() { this.plot.close(); }

  update(store, groups) {
    const parts = store.bridgeParts();
    const state = bridgeState(store);
    this.bridge.hidden = state === null;
    set(this.bridge.firstChild.firstChild, 'data-state', state);
    setIcon(this.symbol, state ?? 'stale');
    this.command.update(parts);
    const series = groups.map((group) => ({name: groups.length > 1 ? group.label : 'load', unit: '%',
      points: store.metrics(group.node, group.bus).get('bus_load')?.points ?? []}));
    this.load.hidden = !series.some(({points}) => points.length);
    if (!this.load.hidden) this.plot.update(series, store.now());
    const errors = groups.flatMap(({row, bus}) => (row?.errors ?? []).slice(0, MOST_ERRORS).map((line) => bus ? `${bus}  ${line}` : line));
    this.failed.hidden = !errors.length;
    each(this.errors, errors.slice(0, MOST_ERRORS), (line) => line, (line) => h('li', {}, line));
    this.found.hidden = !showFindings(this.findings, groups);
  }
}
