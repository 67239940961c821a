// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// The line that moves a recording: play or stop, a slider over its time, what was found in it.

import {each, h, say, set} from './dom.js';
import {span} from './format.js';

const MARKS = ['', '\u25b2', '\u2716', '?'];

export class Player {
  #state = null;
  #found = 0;                  // how many findings are listed
  #isHeld = false;             // somebody moves the slider

  constructor(element) {
    this.element = element;
    this.button = h('button', {class: 'button',
      onclick: () => move({on: this.#state.on ? '0' : '1'})}, 'Play');
    this.slider = h('input', {type: 'range', min: 0, step: 0.1, ariaLabel: 'Time in the recording',
      oninput: () => { this.#isHeld = true; this.#say(Number(this.slider.value)); },
      onchange: () => { this.#isHeld = false; move({at: this.slider.value}); }});
    this.time = h('span', {class: 'player-time'});
    this.list = h('select', {ariaLabel: 'Go to a finding', onchange: () => {
      if (this.list.value) move({at: this.list.value, on: '0'});
      this.list.selectedIndex = 0;
    }});
    element.append(this.button, this.slider, this.time, this.list);
  }

  /** state: {at, length, on, events} of a recording, or null. */
  update(state) {
    this.element.hidden = !state;
    if (!state) return;
    this.#state = state;
    say(this.button, state.on ? 'Stop' : 'Play');
    set(this.slider, 'max', Math.max(state.length, state.at));
    if (!this.#isHeld) {
      this.slider.value = state.at;
      this.#say(state.at);
    }
    if (state.events !== this.#found) this.#fetch(state.events);
  }

  #say(at) {
    const text = `${span(at)} of ${span(this.#state.length)}`;
    say(this.time, text);
    set(this.slider, 'aria-valuetext', text);
  }

  async #fetch(count) {
    this.#found = count;
    const found = await (await fetch('player', {cache: 'no-store'})).json();
    const all = [[null, 0, `${found.length} found`], ...found];
    each(this.list, all.map((one, index) => ({one, index})), ({index}) => index,
      () => h('option'), (option, {one: [at, level, text]}) => {
        set(option, 'value', at === null ? '' : at);
        say(option, at === null ? text : `${MARKS[level]} ${span(at)}: ${text}`);
      });
  }
}

const move = (query) => fetch(`player?${new URLSearchParams(query)}`, {cache: 'no-store'});
