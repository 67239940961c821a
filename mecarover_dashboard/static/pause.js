// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// The button that makes the lists of a view stand still while somebody reads them.

import {h, say, set} from './dom.js';

export class Pause {
  isOn = false;

  /** show() is called when the lists may move again; what: the lists, for a screen reader. */
  constructor(what, show) {
    this.show = show;
    this.element = h('button', {class: 'button small pause', ariaPressed: false,
      ariaDescription: what, onclick: () => this.#press()}, 'Pause');
  }

  #press() {
    this.isOn = !this.isOn;
    set(this.element, 'aria-pressed', this.isOn);
    say(this.element, this.isOn ? 'Paused' : 'Pause');
    if (!this.isOn) this.show();
  }
}
