// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// View 5: the bridge: its last command, its link, what was refused, how long a command takes.

import {Command, COMMAND_KEYS} from './command.js';
import {each, h, icon, say, set, showState} from './dom.js';
import {short, splitUnit} from './format.js';
import {fillEmpty, metricsHead, metricToPlot, panel, seriesOf, showMetrics} from './parts.js';
import {Plot} from './plot.js';
import {stateOf} from './store.js';

export class BridgeView {
  constructor() {
    this.title = 'Bridge';
    this.metric = null;        // chosen by hand
    this.plot = new Plot('Timing', 60);
    this.command = new Command();
    this.cards = {link: card('Link'), commands: card('Commands')};
    this.rows = h('tbody');
    this.empty = h('div', {class: 'empty'});
    this.body = h('div', {class: 'columns'},
      h('div', {},
        panel('Last command', this.command.element),
        this.cards.link.element),
      h('div', {},
        panel('Timing', this.plot.element,
          h('table', {class: 'figures'},
            h('caption', {class: 'unseen'}, 'Timing over the last 10 s'), metricsHead(),
            this.rows)),
        this.cards.commands.element));
    this.element = h('div', {}, h('h1', {class: 'unseen', tabindex: -1}, 'Bridge'), this.empty,
      this.body);
  }

  close() { this.plot.close(); }

  update(store) {
    const {link, commands, timing} = store.bridgeParts();
    const known = Boolean(link || commands || timing.size);
    this.empty.hidden = known;
    this.body.hidden = !known;
    if (!known) {
      fillEmpty(this.empty, store, 'vel2d/timing');
      return;
    }
    const part = store.bridgePart();
    const message = part ? store.said(part) : '';
    this.command.update({link, commands}, message);
    this.cards.link.update(link, part);
    this.cards.commands.update(commands, part);
    const metric = this.metric ?? metricToPlot(timing, 'callback_to_write');
    showMetrics(this.rows, [...timing.values()], metric, (name) => {
      this.metric = name;
      this.update(store);
    });
    this.plot.label = metric.replaceAll('_', ' ');
    this.plot.update(seriesOf(timing.get(metric)), store.now());
  }
}

function card(title) {
  const badge = h('p', {class: 'message'}, icon('stale'), h('span'));
  const rows = h('tbody');
  const element = panel(title, badge,
    h('table', {class: 'fields facts'}, h('caption', {class: 'unseen'}, title), rows));
  return {element, update(row, part) {
    const state = stateOf(row);
    const isOld = part?.is_known === false;
    badge.hidden = isOld || (part && row?.message === part.text);      // said with the command
    set(element, 'data-old', isOld);
    showState(badge, state);
    say(badge.lastChild, row?.message ?? 'no status yet');
    const shown = (row?.values ?? []).filter(([key]) => !COMMAND_KEYS.has(key));
    each(rows, shown, ([key]) => key, makeFact, (line, [key, value]) => {
      say(line.children[1], short(value, 6));
      set(line, 'data-zero', value === '0' && !/Frames|received|accepted/.test(key));
    });
  }};
}

/** A row for one value of a status: name, value, unit. */
export function makeFact([key]) {
  const [name, unit] = splitUnit(key);
  return h('tr', {}, h('th', {scope: 'row'}, name), h('td', {class: 'value'}),
    h('td', {class: 'unit'}, unit));
}
