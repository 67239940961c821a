// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// The last command to the rover: a dial and three numbers, and whether it goes out at all.

import {Dial} from './dial.js';
import {h, say, set} from './dom.js';
import {numberOf} from './format.js';
import {isQuiet, stateOf, valueOf} from './store.js';

const AXES = [['x', 'Last x (m/s)', 'm/s'], ['y', 'Last y (m/s)', 'm/s'],
  ['\u03c9', 'Last omega (rad/s)', 'rad/s']];
export const COMMAND_KEYS = new Set(AXES.map(([, key]) => key));

export class Command {
  constructor() {
    this.dial = new Dial();
    this.driving = h('p', {class: 'driving'});
    this.message = h('p', {class: 'message'});
    this.numbers = AXES.map(([name, , unit]) =>
      h('p', {class: 'axis'}, h('span', {}, name), h('b'), h('small', {}, unit)));
    this.element = h('div', {class: 'command'}, this.dial.element,
      h('div', {class: 'axes'}, this.driving, ...this.numbers), this.message);
  }

  /** message: what is said of the bridge, '' where it is said elsewhere in the view. */
  update({link, commands}, message) {
    const values = AXES.map(([, key]) => valueOf(link, key) ?? '');
    const numbers = values.map(numberOf);
    const isSent = !isQuiet(link) && stateOf(link) !== 'error';
    const state = isSent ? valueOf(commands, 'State') ?? 'unknown'
      : isQuiet(link) ? 'no report' : 'not sent';
    this.dial.update(...numbers.map((value) => Number.isFinite(value) ? value : 0));
    this.numbers.forEach((element, at) =>
      say(element.children[1], written(numbers[at], values[at])));
    say(this.driving, state);
    set(this.driving, 'data-driving', state === 'driving');
    set(this.driving, 'data-state', isSent ? null : 'error');
    set(this.element, 'data-old', !isSent);
    say(this.message, message);
    set(this.message, 'data-state', isSent ? null : 'error');
    this.message.hidden = !message || message === state;
    set(this.dial.element, 'aria-label', `Last command: x ${values[0]} m/s, y ${values[1]} m/s, `
      + `omega ${values[2]} rad/s; ${state}`);
  }
}

function written(number, text) {
  if (!Number.isFinite(number)) return text || '\u2013';
  if (Math.abs(number) >= 1e4) return number.toExponential(1);
  const rounded = number.toFixed(2);
  return Number(rounded) === 0 ? '0.00' : rounded.replace('-', '\u2212');
}
