// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// View 0: all robots of the domain, a card each: its worst, the bridge, its buses.

import {each, h, icon, say, sayWords, set, showState} from './dom.js';
import {plural} from './format.js';
import {pathOfRobot} from './place.js';
import {countOf, robotName, WORDS, worst, worstFirst} from './store.js';

export class Robots {
  constructor() {
    this.title = 'Robots';
    this.list = h('ul', {class: 'robots'});
    this.element = h('div', {}, h('h1', {tabindex: -1}, 'Robots'), this.list);
  }

  update(store) {
    const robots = store.robots().map((name) => robotOf(store, name))
      .sort((a, b) => worstFirst(a.state, b.state) || (a.name < b.name ? -1 : 1));
    store.show(null);
    each(this.list, robots, ({name}) => name, makeCard, updateCard);
  }
}

/** The text on the card of a robot: what its bridge and each of its buses say. */
function robotOf(store, name) {
  store.show(name);
  const counts = new Map(store.groups().map(({key, devices, part}) =>
    [key, `${countOf(devices, part)} of ${devices.length} answer; `]));
  const lines = store.parts().map((part) => {
    const count = counts.get(`${part.node}/${part.bus}`) ?? '';
    const of = part.bus === '' ? '' : `${part.bus ?? 'Bridge'}: `;
    return [part.row_name, part.state, `${count}${of}${store.said(part, part.text)}`,
      part.is_known];
  });
  const total = store.groups().reduce((count, group) => count + group.devices.length, 0);
  return {name, lines, total, state: worst(lines.map(([, state]) => state)),
    isKnown: lines.every(([, , , isKnown]) => isKnown)};
}

function makeCard({name}) {
  return h('li', {}, h('a', {class: 'robot', href: pathOfRobot(name)},
    h('p', {class: 'robot-head'}, icon('ok'), h('b', {}, robotName(name)), h('span')),
    h('ul', {class: 'robot-lines'})));
}

function updateCard(item, robot) {
  const [head, lines] = item.firstChild.children;
  set(item.firstChild, 'data-state', robot.state);
  set(item.firstChild, 'data-known', String(robot.isKnown));
  showState(head, robot.state);
  const word = robot.isKnown ? WORDS[robot.state] : 'Not known';
  say(head.lastChild, `${word} \u00b7 ${plural(robot.total, 'device')}`);
  each(lines, robot.lines, ([key]) => key, () => h('li', {}, icon('ok'), h('span')),
    (line, [, state, text]) => {
      showState(line, state);
      sayWords(line.lastChild, text);
    });
}
