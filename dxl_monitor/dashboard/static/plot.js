// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// A small plot on a canvas: time to the left, one unit, up to a handful of series, a cursor.

import {figure} from './format.js';
import {each, h, say, set} from './dom.js';
import {GAP_S} from './store.js';

const SPANS = [[10, '10 s'], [60, '1 min'], [300, '5 min']];
const LEFT = 52, RIGHT = 10, TOP = 8, BOTTOM = 20;
const STEPS = [1, 2, 2.5, 5, 10];

export class Plot {
  #series = [];
  #now = 0;
  #cursor = null;              // s before now
  #drawn = '';

  /** `extra` are elements that stand below the plot, before the choice of time. */
  constructor(label, span = 60, ...extra) {
    this.span = span;
    this.canvas = h('canvas', {tabindex: 0, role: 'img', ariaLabel: label});
    this.legend = h('ul', {class: 'legend'});
    this.spans = h('div', {class: 'choice', role: 'group', ariaLabel: 'Time shown'}, ...SPANS.map(([s, text]) =>
      h('button', {type: 'button', 'data-span': s, onclick: () => this.#show(s)}, text)));
    this.element = h('div', {class: 'plot'}, this.legend, this.canvas, h('div', {class: 'plot-foot'}, ...extra, this.spans));
    this.label = label;
    this.canvas.addEventListener('pointermove', (event) => this.#point(event.offsetX));
    this.canvas.addEventListener('pointerdown', (event) => this.#point(event.offsetX));
    this.canvas.addEventListener('pointerleave', (event) => { if (event.pointerType === 'mouse') this.#move(null); });
    this.canvas.addEventListener('blur', () => this.#move(null));
    this.canvas.addEventListener('keydown', (event) => this.#key(event));
    this.observer = new ResizeObserver(() => this.draw());
    this.observer.observe(this.canvas);
    this.redraw = () => this.draw();
    addEventListener('theme', this.redraw);
    this.#show(span);
  }

  close() {
    this.observer.disconnect();
    removeEventListener('theme', this.redraw);
  }

  /** Show series [{name, unit, points: [[s, value], ...]}] up to now (s). */
  update(series, now) {
    this.#series = series;
    this.#now = now;
    this.draw();
  }

  #show(span) {
    this.span = span;
    for (const button of this.spans.children) set(button, 'aria-pressed', Number(button.dataset.span) === span);
    this.draw();
  }

  #point(x) { this.#move((1 - (x - LEFT) / (this.canvas.clientWidth - LEFT - RIGHT)) * this.span); }

  #move(cursor) {
    this.#cursor = cursor === null ? null : Math.min(this.span, Math.max(0, cursor));
    this.draw();
  }

  #key(event) {
    const step = {ArrowLeft: 1, ArrowRight: -1}[event.key];
    if (step) this.#move((this.#cursor ?? 0) + step * this.span / 60);
    else if (event.key === 'Escape') this.#move(null);
    else return;
    event.preventDefault();
  }

  draw() {
    const {clientWidth: width, clientHeight: height} = this.canvas;
    if (!width || !height) return;
    const scale = devicePixelRatio || 1;
    if (this.canvas.width !== Math.round(width * scale)) this.canvas.width = Math.round(width * scale);
    if (this.canvas.height !== Math.round(height * scale)) this.canvas.height = Math.round(height * scale);
    const pen = this.canvas.getContext('2d');
    const colours = coloursOf(this.canvas);
    pen.setTransform(scale, 0, 0, scale, 0, 0);
    pen.clearRect(0, 0, width, height);
    const area = {left: LEFT, top: TOP, width: width - LEFT - RIGHT, height: height - TOP - BOTTOM};
    const shown = this.#series.map((one) => ({...one, points: since(one.points, this.#now - this.span)}));
    const ticks = ticksOf(...rangeOf(shown), Math.max(4, Math.floor(area.height / 30)));
    const at = {
      x: (s) => area.left + area.width * (1 - (this.#now - s) / this.span),
      y: (value) => area.top + area.height * (1 - (value - ticks.low) / (ticks.high - ticks.low)),
    };
    drawGrid(pen, area, at, ticks, this.span, this.#now, colours);
    pen.save();
    pen.beginPath();
    pen.rect(area.left, 0, area.width + RIGHT, height);
    pen.clip();
    shown.forEach((one, index) => drawLine(pen, one.points, at, colours.lines[index % colours.lines.length], index, this.#now));
    pen.restore();
    this.#readOut(pen, area, at, shown, colours);
  }

  #readOut(pen, area, at, shown, colours) {
    const s = this.#cursor === null ? null : this.#now - this.#cursor;
    const rows = shown.map((one, index) => {
      const point = s === null ? one.points.at(-1) : nearest(one.points, s);
      return {...one, index, point};
    });
    if (s !== null) {
      pen.strokeStyle = colours.text;
      pen.lineWidth = 1;
      pen.beginPath();
      pen.moveTo(at.x(s), area.top);
      pen.lineTo(at.x(s), area.top + area.height);
      pen.stroke();
      for (const {point, index} of rows) if (point) drawDot(pen, at.x(point[0]), at.y(point[1]), colours.lines[index % colours.lines.length]);
    }
    each(this.legend, rows, (row) => row.name, () => h('li', {}, h('i', {class: 'swatch'}), h('span'), h('b')), (item, row) => {
      set(item.firstChild, 'data-line', row.index % colours.lines.length);
      say(item.children[1], row.name);
      say(item.lastChild, row.point ? `${figure(row.point[1])}${row.unit ? ` ${row.unit}` : ''}${s === null ? '' : ` at \u2212${figure(this.#cursor, 3)} s`}` : 'no data');
    });
    const text = rows.map((row) => `${row.name} ${row.point ? `${figure(row.point[1])} ${row.unit}` : 'no data'}`).join(', ');
    if (text !== this.#drawn) set(this.canvas, 'aria-label', `${this.label}: ${this.#drawn = text}`);
  }
}

function coloursOf(canvas) {
  const style = getComputedStyle(canvas);
  const get = (name) => style.getPropertyValue(name).trim();
  return {grid: get('--line'), label: get('--muted'), text: get('--text'), lines: ['--plot-0', '--plot-1', '--plot-2', '--plot-3'].map(get)};
}

/** The points from a time on, and the last one before it. */
function since(points, s) {
  let low = 0;
  let high = points.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (points[middle][0] < s) low = middle + 1; else high = middle;
  }
  return points.slice(Math.max(0, low - 1));
}

function nearest(points, s) {
  let best = null;
  for (const point of points) {
    if (point[1] !== null && (!best || Math.abs(point[0] - s) < Math.abs(best[0] - s))) best = point;
  }
  return best && Math.abs(best[0] - s) < GAP_S ? best : null;
}

function rangeOf(shown) {
  let low = Infinity;
  let high = -Infinity;
  for (const {points} of shown) {
    for (const [, value] of points) {
      if (value === null) continue;
      if (value < low) low = value;
      if (value > high) high = value;
    }
  }
  if (low > high) return [0, 1];
  if (low >= 0 && low < 0.6 * high) low = 0;         // from zero, where that costs little
  const pad = high > low ? 0.06 * (high - low) : Math.max(Math.abs(high) * 0.1, 0.5);
  return [low === 0 ? 0 : low - pad, high + pad];
}

/** Round ticks that cover a range: {low, high, step}. */
export function ticksOf(low, high, count) {
  const raw = (high - low) / count;
  const size = 10 ** Math.floor(Math.log10(raw));
  const step = size * STEPS.find((one) => one * size >= raw * 0.999);
  return {low, high, step, first: Math.ceil(low / step) * step};
}

function drawGrid(pen, area, at, ticks, span, now, colours) {
  pen.font = '11px system-ui, sans-serif';
  pen.strokeStyle = colours.grid;
  pen.fillStyle = colours.label;
  pen.lineWidth = 1;
  pen.textAlign = 'right';
  pen.textBaseline = 'middle';
  pen.beginPath();
  for (let value = ticks.first; value <= ticks.high + ticks.step * 1e-6; value += ticks.step) {
    const y = Math.round(at.y(value)) + 0.5;
    pen.moveTo(area.left, y);
    pen.lineTo(area.left + area.width, y);
    pen.fillText(figure(Math.abs(value) < ticks.step * 1e-6 ? 0 : Number(value.toPrecision(6)), 5).replace('-', '\u2212'), area.left - 6, y);
  }
  pen.textBaseline = 'alphabetic';
  const parts = area.width > 420 ? 6 : 3;
  for (let part = 0; part <= parts; part++) {
    const s = span * part / parts;
    const x = Math.round(at.x(now - s)) + 0.5;
    pen.moveTo(x, area.top + area.height);
    pen.lineTo(x, area.top + area.height + 4);
    pen.textAlign = part === 0 ? 'right' : 'center';
    pen.fillText(part === 0 ? 'now' : `\u2212${figure(s, 3)} s`, part === 0 ? x + RIGHT - 2 : x, area.top + area.height + 16);
  }
  pen.stroke();
}

function drawLine(pen, points, at, colour, index, now) {
  pen.strokeStyle = colour;
  pen.lineWidth = 1.6;
  pen.lineJoin = 'round';
  pen.setLineDash(index === 0 ? [] : [[6, 3], [2, 3], [9, 3, 2, 3]][(index - 1) % 3]);
  pen.beginPath();
  let before = null;
  for (const point of points) {
    if (point[1] === null) {
      before = null;
      continue;
    }
    if (before && point[0] - before[0] < GAP_S) pen.lineTo(at.x(point[0]), at.y(point[1]));
    else pen.moveTo(at.x(point[0]), at.y(point[1]));
    before = point;
  }
  pen.stroke();
  if (before && now - before[0] > GAP_S) drawHeld(pen, at.x(before[0]), at.x(now), at.y(before[1]));
  pen.setLineDash([]);
}

/** A value that was not seen since: still the last one known, but no measurement. */
function drawHeld(pen, from, to, y) {
  pen.setLineDash([1, 5]);
  pen.lineWidth = 1.2;
  pen.beginPath();
  pen.moveTo(from, y);
  pen.lineTo(to, y);
  pen.stroke();
}

function drawDot(pen, x, y, colour) {
  pen.fillStyle = colour;
  pen.beginPath();
  pen.arc(x, y, 3.5, 0, 7);
  pen.fill();
}
