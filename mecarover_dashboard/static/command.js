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
    this.why = h('p', {class: 'message'});
    this.numbers = AXES.map(([name, , unit]) =>
      h('p', {class: 'axis'}, h('span', {}, name), h('b'), h('small', {}, unit)));
    this.element = h('div', {class: 'command'}, this.dial.element,
      h('div', {class: 'axes'}, this.driving, ...this.numbers), this.why);
  }

  update({link, commands}) {
    const values = AXES.map(([, key]) => valueOf(link, key) ?? '');
    const numbers = values.map(numberOf);
    const [state, why, note] = said(link, commands);
    this.dial.update(...numbers.map((value) => Number.isFinite(value) ? value : 0));
    this.numbers.forEach((element, at) =>
      say(element.children[1], written(numbers[at], values[at])));
    say(this.driving, state);
    set(this.driving, 'data-driving', state === 'driving');
    set(this.driving, 'data-state', why ? 'error' : null);
    set(this.element, 'data-old', why !== '');
    say(this.why, why || note);
    set(this.why, 'data-state', why ? 'error' : null);
    this.why.hidden = !why && !note;
    set(this.dial.element, 'aria-label', `Last command: x ${values[0]} m/s, y ${values[1]} m/s, `
      + `omega ${values[2]} rad/s; ${state}`);
  }
}

/**
 * A word for the state of the command; why it does not reach the rover, '' if it does; what a
 * status that is well says besides.
 */
function said(link, commands) {
  if (isQuiet(link)) {
    return ['no report', 'The bridge is not responding: these values are old.', ''];
  }
  if (stateOf(link) === 'error') return ['not sent', link.message, ''];
  const state = valueOf(commands, 'State') ?? 'unknown';
  const saysMore = commands && stateOf(commands) === 'ok' && commands.message !== state;
  return [state, '', saysMore ? commands.message : ''];
}

function written(number, text) {
  if (!Number.isFinite(number)) return text || '\u2013';
  if (Math.abs(number) >= 1e4) return number.toExponential(1);
  const rounded = number.toFixed(2);
  return Number(rounded) === 0 ? '0.00' : rounded.replace('-', '\u2212');
}
