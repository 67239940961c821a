// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// The last command to the rover: a dial and three numbers.

import {Dial} from './dial.js';
import {h, say, set} from './dom.js';
import {numberOf} from './format.js';
import {valueOf} from './store.js';

const AXES = [['x', 'Last x (m/s)', 'm/s'], ['y', 'Last y (m/s)', 'm/s'], ['\u03c9', 'Last omega (rad/s)', 'rad/s']];
export const COMMAND_KEYS = new Set(AXES.map(([, key]) => key));

export class Command {
  constructor() {
    this.dial = new Dial();
    this.driving = h('p', {class: 'driving'});
    this.numbers = AXES.map(([name, , unit]) => h('p', {class: 'axis'}, h('span', {}, name), h('b'), h('small', {}, unit)));
    this.element = h('div', {class: 'command'}, this.dial.element, h('div', {class: 'axes'}, this.driving, ...this.numbers));
  }

  update({link, commands}) {
    const values = AXES.map(([, key]) => valueOf(link, key) ?? '');
    const numbers = values.map(numberOf);
    this.dial.update(...numbers.map((value) => Number.isFinite(value) ? value : 0));
    this.numbers.forEach((element, at) => say(element.children[1], written(numbers[at], values[at])));
    const state = valueOf(commands, 'State') ?? 'unknown';
    say(this.driving, state);
    set(this.driving, 'data-driving', state === 'driving');
    set(this.dial.element, 'aria-label', `Last command: x ${values[0]} m/s, y ${values[1]} m/s, omega ${values[2]} rad/s; ${state}`);
  }
}

function written(number, text) {
  if (!Number.isFinite(number)) return text || '\u2013';
  const rounded = number.toFixed(2);
  return Number(rounded) === 0 ? '0.00' : rounded.replace('-', '\u2212');
}
