// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// View 0: all robots of the domain, a card each: its worst, the bridge, its buses.

import {each, h, icon, say, set, setIcon} from './dom.js';
import {plural} from './format.js';
import {pathOfRobot} from './place.js';
import {bridgeHeadline, WORDS, worst} from './store.js';

export class Robots {
  constructor() {
    this.title = 'Robots';
    this.list = h('ul', {class: 'robots'});
    this.element = h('div', {}, h('h1', {tabindex: -1}, 'Robots'), this.list);
  }

  update(store) {
    const robots = store.robots().map((name) => robotOf(store, name))
      .sort((a, b) => RANK[a.state] - RANK[b.state] || (a.name < b.name ? -1 : 1));
    store.show(null);
    each(this.list, robots, ({name}) => name, makeCard, updateCard);
  }
}

const RANK = {error: 0, stale: 1, warn: 2, ok: 3};
const nameOf = (robot) => robot || 'no namespace';

/** The text on the card of a robot: [state, text] of its bridge and each of its buses. */
export function robotOf(store, name) {
  store.show(name);
  const groups = store.groups();
  const bridge = bridgeHeadline(store.bridgeParts(), store.now());
  const lines = [
    ...bridge ? [['bridge', bridge.state, `Bridge: ${bridge.text}`]] : [],
    ...groups.map((group) => [group.key, group.state, `${group.there}/${group.devices.length} `
      + `${group.bus ? `${group.bus}: ` : ''}${group.headline}`])];
  const total = groups.reduce((count, group) => count + group.devices.length, 0);
  return {name, lines, total, state: worst(lines.map(([, state]) => state))};
}

function makeCard({name}) {
  return h('li', {}, h('a', {class: 'robot', href: pathOfRobot(name)},
    h('p', {class: 'robot-head'}, icon('ok'), h('b', {}, nameOf(name)), h('span')),
    h('ul', {class: 'robot-lines'})));
}

function updateCard(item, robot) {
  const [head, lines] = item.firstChild.children;
  set(item.firstChild, 'data-state', robot.state);
  set(head, 'data-state', robot.state);
  setIcon(head.firstChild, robot.state);
  say(head.lastChild, `${WORDS[robot.state]} \u00b7 ${plural(robot.total, 'device')}`);
  each(lines, robot.lines, ([key]) => key, () => h('li', {}, icon('ok'), h('span')),
    (line, [, state, text]) => {
      set(line, 'data-state', state);
      setIcon(line.firstChild, state);
      say(line.lastChild, text);
    });
}
