// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// The last command as a pilot reads it: where to, how fast, which turn. x is up, y is left.

import {svg} from './dom.js';

const TURN = 88;               // radius of the arc
const ARROW = 66;              // length at full scale
const SCALES = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20];

export class Dial {
  constructor() {
    this.arrow = svg('g', {class: 'dial-arrow'}, svg('path', {d: ''}), svg('path', {d: ''}));
    this.turn = svg('path', {class: 'dial-turn', d: ''});
    this.tip = svg('path', {class: 'dial-tip', d: ''});
    this.scale = svg('text', {x: 4, y: ARROW - 4, class: 'dial-scale'});
    this.element = svg('svg', {class: 'dial', viewBox: '-104 -104 208 208', role: 'img', 'aria-label': 'Last command'},
      svg('circle', {r: TURN, class: 'dial-rim'}), svg('circle', {r: ARROW, class: 'dial-ring'}), svg('circle', {r: ARROW / 2, class: 'dial-ring'}),
      svg('path', {d: `M0 ${-TURN}V${TURN}M${-TURN} 0H${TURN}`, class: 'dial-ring'}),
      ...ticks(), svg('path', {d: 'M-13-17h26v34h-26zM-17-14v9m0 10v9m34-28v9m0 10v9', class: 'dial-rover'}),
      this.turn, this.tip, this.arrow, this.scale);
  }

  /** Show x, y (m/s) and omega (rad/s); NaN = unknown. */
  update(x, y, omega) {
    const speed = Math.hypot(x, y);
    const full = SCALES.find((one) => one >= speed) ?? speed;
    this.scale.textContent = `${full} m/s`;
    const [line, head] = this.arrow.children;
    const length = ARROW * speed / full;
    const moves = length > 2;
    const angle = Math.atan2(-y, x);           // clockwise from up
    const to = (r, a) => `${(r * Math.sin(a)).toFixed(1)} ${(-r * Math.cos(a)).toFixed(1)}`;
    line.setAttribute('d', moves ? `M0 0L${to(Math.max(0, length - 6), angle)}` : '');
    head.setAttribute('d', moves ? `M${to(length, angle)}L${to(Math.max(0, length - 13), angle - 7 / length)}L${to(Math.max(0, length - 13), angle + 7 / length)}Z` : '');
    this.#turn(omega, to);
  }

  #turn(omega, to) {
    const sweep = Math.max(-2.8, Math.min(2.8, -omega));       // one rad of arc per rad/s; left is positive
    const shows = Math.abs(sweep) > 0.02;
    this.turn.setAttribute('d', shows ? `M0 ${-TURN}A${TURN} ${TURN} 0 0 ${sweep > 0 ? 1 : 0} ${to(TURN, sweep)}` : '');
    const back = sweep - Math.sign(sweep) * 0.12;
    this.tip.setAttribute('d', shows ? `M${to(TURN, sweep + Math.sign(sweep) * 0.04)}L${to(TURN - 7, back)}L${to(TURN + 7, back)}Z` : '');
  }
}

function ticks() {
  return [...Array(36).keys()].map((at) => svg('path', {
    d: `M0 ${-TURN - 4}v${at % 9 === 0 ? -8 : -4}`, transform: `rotate(${at * 10})`, class: 'dial-ring'}));
}
