// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// Around the buses of the overview: the bridge at a glance, what was found, load, latest errors.

import {Command} from './command.js';
import {h, icon, set, showState} from './dom.js';
import {ErrorList, errorsOf} from './errors.js';
import {FindingList} from './findings.js';
import {panel} from './parts.js';
import {path} from './place.js';
import {Plot} from './plot.js';

const MOST_ERRORS = 6;

const heading = (to, ...children) => h('a', {class: 'more', href: path(to)}, ...children);

export class OverviewSidebar {
  constructor(pause) {
    this.plot = new Plot('Bus load', 300);
    this.command = new Command();
    this.bridge = panel(heading('bridge', icon('ok'), 'Bridge'), this.command.element);
    this.load = panel(heading('log', 'Bus load'), this.plot.element);
    this.load.classList.add('low');
    this.findings = new FindingList(heading('log', 'Findings'), pause);
    this.errors = new ErrorList(heading('log', 'Last errors'), pause, {most: MOST_ERRORS});
    this.element = h('div', {class: 'aside'}, this.bridge, this.findings.element);
    this.below = h('div', {class: 'below'}, this.load, this.errors.element);
  }

  close() { this.plot.close(); }

  /** groups are the alerts shown in the same view: a finding with the same text is left out. */
  update(store, groups) {
    const bridge = store.bridgePart();
    const state = bridge?.state ?? null;
    this.bridge.hidden = state === null;
    showState(this.bridge.firstChild.firstChild, state ?? 'stale');
    this.command.update(store.bridgeParts(), state === 'ok' ? bridge.text : '');   // else: its bar
    const isMany = groups.length > 1;
    const series = groups.map((group) => ({name: isMany ? group.label : 'load', unit: '%',
      points: store.metrics(group.node, group.bus).get('bus_load')?.points ?? []}));
    this.load.hidden = !series.some(({points}) => points.length);
    set(this.load, 'data-old', groups.some(({part}) => !part.is_known));
    if (!this.load.hidden) this.plot.update(series, store.now(), {low: 0});
    this.errors.element.hidden = !this.errors.update(errorsOf(groups, store), isMany);
    const isSaid = (text, device) => device ? device.message === text
      : groups.some((group) => group.text.includes(text));
    this.findings.element.hidden = !this.findings.update(groups, store, isSaid);
  }
}
