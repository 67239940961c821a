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
    this.element = svg('svg', {class: 'dial', viewBox: '-104 -104 208 208', role: 'img',
      'aria-label': 'Last command'},
    svg('circle', {r: TURN, class: 'dial-rim'}), svg('circle', {r: ARROW, class: 'dial-ring'}),
    svg('circle', {r: ARROW / 2, class: 'dial-ring'}),
    svg('path', {d: `M0 ${-TURN}V${TURN}M${-TURN} 0H${TURN}`, class: 'dial-ring'}), ...ticks(),
    svg('path', {d: 'M-13-17h26v34h-26zM-17-14v9m0 10v9m34-28v9m0 10v9', class: 'dial-rover'}),
    this.turn, this.tip, this.arrow, this.scale);
  }

  /** Show x, y (m/s) and omega (rad/s). */
  update(x, y, omega) {
    const speed = Math.hypot(x, y);
    const full = SCALES.find((one) => one >= speed) ?? speed;
    this.scale.textContent = full < 1e6 ? `${full} m/s` : 'out of range';
    const [line, head] = this.arrow.children;
    const length = ARROW * speed / full;
    const angle = Math.atan2(-y, x);           // clockwise from up
    line.setAttribute('d', length > 2 ? `M0 0L${to(Math.max(0, length - 6), angle)}` : '');
    head.setAttribute('d', length > 2 ? tip(length, angle) : '');
    this.#turn(omega);
  }

  /** One rad of arc per rad/s, at most 2.8; a turn to the left is positive. */
  #turn(omega) {
    const sweep = Math.max(-2.8, Math.min(2.8, -omega));
    const shows = Math.abs(sweep) > 0.02;
    const side = sweep > 0 ? 1 : 0;
    this.turn.setAttribute('d',
      shows ? `M0 ${-TURN}A${TURN} ${TURN} 0 0 ${side} ${to(TURN, sweep)}` : '');
    const back = sweep - Math.sign(sweep) * 0.12;
    const front = sweep + Math.sign(sweep) * 0.04;
    this.tip.setAttribute('d',
      shows ? `M${to(TURN, front)}L${to(TURN - 7, back)}L${to(TURN + 7, back)}Z` : '');
  }
}

/** A point at a radius and an angle, clockwise from up. */
const to = (r, angle) =>
  `${(r * Math.sin(angle)).toFixed(1)} ${(-r * Math.cos(angle)).toFixed(1)}`;

function tip(length, angle) {
  const back = Math.max(0, length - 13);
  return `M${to(length, angle)}L${to(back, angle - 7 / length)}L${to(back, angle + 7 / length)}Z`;
}

function ticks() {
  return [...Array(36).keys()].map((at) => svg('path', {
    d: `M0 ${-TURN - 4}v${at % 9 === 0 ? -8 : -4}`, transform: `rotate(${at * 10})`,
    class: 'dial-ring'}));
}
