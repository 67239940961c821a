// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// A small plot on a canvas: time to the left, one unit, up to a handful of series, a cursor, and a
// part of the time that is chosen by dragging.

import {differenceOf, drawPlot, nearOf, readAt} from './draw.js';
import {clock, isInRange, span as spanText} from './format.js';
import {each, h, say, set} from './dom.js';
import {choice, showChosen} from './parts.js';
import {measured, shownIn, withUnit} from './units.js';

const SPANS = [[10, '10 s'], [60, '1 min'], [300, '5 min']];
const LEAST_DRAG = 12;         // px; less is a touch
const CALM_S = 0.45;           // least time between two moves of the plot
const LEAST_SPAN_S = 0.01;
const STEPS = 300;             // in which a plot moves from one edge to the other

export class Plot {
  #series = [];
  #now = 0;
  #options = {};
  #cursor = null;              // s before the right edge
  #mark = null;                // s: from where differences to the cursor are counted
  #drag = null;                // where it began, px
  #held = null;                // where a finger holds the time shown, px
  #zoom = null;                // [from, to] in s; null: up to now
  #drawn = '';
  #drawnAt = -Infinity;        // s of the page

  /** `extra` are elements that stand below the plot, before the choice of time. */
  constructor(label, span = 60, ...extra) {
    this.span = span;
    this.label = label;
    this.canvas = h('canvas', {tabindex: 0, role: 'img', ariaLabel: label});
    this.legend = h('ul', {class: 'legend'});
    this.back = h('button', {class: 'button', onclick: () => this.#zoomTo(null)},
      'Live');
    this.spans = choice('Time shown', SPANS, (s) => this.#show(s));
    this.element = h('div', {class: 'plot'}, this.legend, this.canvas,
      h('div', {class: 'plot-foot'}, ...extra, this.back, this.spans));
    this.#listen();
    this.#show(span);
  }

  #listen() {
    const {canvas} = this;
    const on = (name, act) => canvas.addEventListener(name, act);
    on('pointerdown', (event) => {
      if (event.shiftKey) this.#setMark(this.#at(event.offsetX));
      else if (this.isZoomed && event.pointerType === 'touch') this.#held = event.offsetX;
      else this.#drag = event.offsetX;
      this.#point(event.offsetX);
    });
    on('pointermove', (event) => {
      if (this.#held !== null) this.#pan(event.offsetX);
      else this.#point(event.offsetX);
    });
    on('pointerup', (event) => this.#choose(event.offsetX));
    on('pointercancel', () => { this.#drag = this.#held = null; });
    on('dblclick', () => this.#zoomTo(null));
    on('pointerleave', (event) => {
      this.#drag = this.#held = null;
      if (event.pointerType === 'mouse') this.#move(null);
    });
    on('blur', () => this.#move(null));
    on('keydown', (event) => this.#key(event));
    on('wheel', (event) => {
      if (!this.bounds) return;
      event.preventDefault();
      this.#zoomTo(turned(this.range, this.#at(event.offsetX), event, this.bounds()));
    });
    this.observer = new ResizeObserver(() => this.draw());
    this.observer.observe(canvas);
    this.redraw = () => this.draw();
    addEventListener('theme', this.redraw);
  }

  close() {
    this.observer.disconnect();
    removeEventListener('theme', this.redraw);
  }

  /**
   * Show series [{name, unit, note, points: [[s, value or null] or [s, low, high, last], ...],
   * pointAt, hasDots, isSampled, remove}] up to now (s): a dot for each point where they are far
   * apart, wherever they are samples; what its button does. All are in one unit, as it is reported.
   * pointAt: as in readAt(). With `step` a point [s, low, high] is of so many s: together they are
   * a band.
   * options: `low`, where the scale begins; `limits`, [[name, value], ...]; `gap`, s without a
   * point that break the line; `unix(s)`, the Unix time of a time; `timeOfDay(s)`, a text after
   * it; `zero`, s that are called now; `rest`, s between two moves of the plot.
   */
  update(series, now, options = {}) {
    const isOther = series.map(nameOf).join() !== this.#series.map(nameOf).join();
    const [unit, factor] = shownIn(series[0]?.unit ?? '');
    const scaled = (point) => point && [point[0], ...point.slice(1).map(times(factor))];
    this.#series = factor === 1 ? series : series.map((one) => ({...one, unit,
      points: one.points.map(scaled), pointAt: one.pointAt && ((s) => scaled(one.pointAt(s)))}));
    this.#now = now;
    this.#options = {...options, unit,
      limits: options.limits?.map(([name, value]) => [name, factor * value])};
    const rest = options.rest ?? Math.max(CALM_S, this.span / STEPS);
    if (isOther || performance.now() / 1000 - this.#drawnAt > rest) this.draw();
  }

  /** Show so many seconds; no choice of time where the view has one of its own. */
  cover(span, {isQuiet = false} = {}) {
    this.spans.hidden = true;
    this.span = span;
    if (!isQuiet) this.draw();
  }

  /** How many columns of pixels the lines have. */
  get width() { return Math.max(1, Math.round(this.#area.width * devicePixelRatio)); }

  #show(span) {
    this.span = span;
    showChosen(this.spans, span);
    this.#zoomTo(null);
  }

  #zoomTo(zoom) {
    if (this.onZoom) {
      this.onZoom(zoom);
      return;
    }
    this.#zoom = zoom;
    this.back.hidden = !zoom;
    this.draw();
  }

  /** What the plot covers: [from, to] in s. */
  get range() { return this.#zoom ?? [this.#now - this.span, this.#now]; }

  #at(x) {
    const {left, width} = this.#area;
    const [from, to] = this.range;
    return from + (to - from) * Math.min(1, Math.max(0, (x - left) / width));
  }

  #area = {left: 0, width: 1};
  onZoom = null;               // who shows another time instead, given [from, to]; null: up to now
  isZoomed = false;            // a finger moves the time shown
  bounds = null;               // gives [from, to] that the wheel can reach; null: it scrolls the page
  next = null;                 // gives where an arrow key leads from a time, by 1 or -1; or null
  onMark = () => {};           // given the time that is marked, or null
  onCursor = () => {};         // given where the cursor is, s before the right edge, or null

  #point(x) { this.#move(this.range[1] - this.#at(x)); }

  #pan(x) {
    const [from, to] = this.range;
    const [first, last] = this.bounds();
    const move = this.#at(this.#held) - this.#at(x);
    const by = Math.max(first - from, Math.min(last - to, move));
    this.#held = x;
    this.#zoomTo([from + by, to + by]);
  }

  #choose(x) {
    const from = this.#drag;
    this.#drag = this.#held = null;
    if (from !== null && Math.abs(x - from) >= LEAST_DRAG) {
      this.#zoomTo([this.#at(Math.min(x, from)), this.#at(Math.max(x, from))]);
    } else {
      this.draw();
    }
  }

  #move(cursor) {
    this.point(cursor);
    this.onCursor(this.#cursor);
  }

  /** Put the cursor so many seconds before the right edge; null: nowhere. */
  point(cursor) {
    const [from, to] = this.range;
    this.#cursor = cursor === null ? null : Math.min(to - from, Math.max(0, cursor));
    this.draw();
  }

  #setMark(s) {
    this.mark(s);
    this.onMark(s);
  }

  /** Count differences from a time; null: from none. */
  mark(s) {
    this.#mark = s;
    this.draw();
  }

  #key(event) {
    const step = {ArrowLeft: -1, ArrowRight: 1}[event.key];
    const leap = {PageDown: -1, PageUp: 1}[event.key];
    const turn = {'+': -1, '-': 1}[event.key];
    const [from, to] = this.range;
    const s = to - (this.#cursor ?? 0);
    const part = (to - from) / 60;
    if (this.bounds && (turn || step && event.shiftKey)) {
      this.#zoomTo(turned(this.range, to - (this.#cursor ?? (to - from) / 2), {
        deltaX: turn ? 0 : step, deltaY: turn ?? 0, deltaMode: 1}, this.bounds()));
    } else if (step) this.#move(to - (this.next?.(s, step) ?? s + step * part));
    else if (leap) this.#move(to - s - leap * 6 * part);
    else if (event.key === 'Enter') this.#setMark(s);
    else if (event.key === 'Escape' && this.#mark !== null) this.#setMark(null);
    else if (event.key === 'Escape') this.#zoomTo(null);
    else return;
    event.preventDefault();
  }

  draw() {
    this.#drawnAt = performance.now() / 1000;
    const [from, to] = this.range;
    const s = this.#cursor === null ? null : to - this.#cursor;
    const drag = this.#drag === null || s === null ? null : [this.#at(this.#drag), s].sort(
      (a, b) => a - b);
    const shown = this.#series.map((one) => ({...one, points: within(one.points, from, to)}));
    const drawn = drawPlot(this.canvas, shown, {...this.#options, from, to, cursor: s, drag,
      mark: isWithin(this.#mark, this.range) ? this.#mark : null,
      isLive: !this.#zoom, now: this.#zero});
    this.#area = drawn ?? this.#area;
    this.#tell(shown, s);
  }

  get #zero() { return this.#options.zero ?? this.#now; }

  #tell(shown, s) {
    const {gap, unix, timeOfDay = () => ''} = this.#options;
    const near = nearOf(this.#area, ...this.range);
    const mark = s !== null && isWithin(this.#mark, this.range) ? this.#mark : null;
    const rows = shown.map((one, index) => {
      const {step, isSampled, pointAt} = one;
      const points = s === null ? one.points.filter(([time]) => time <= this.range[1]) : one.points;
      const read = (time) => readAt(points, time, near, {gap, step, isSampled, pointAt});
      const value = read(s);
      return {...one, index, value, difference: mark !== null && differenceOf(read(mark), value)};
    });
    const when = s === null ? '' : unix ? ` at ${clock(unix(s))}`
      : ` at \u2212${spanText(this.#zero - s)}${timeOfDay(s)}`;
    each(this.legend, rows, (row) => row.name,
      (row) => h('li', {}, h('i', {class: 'swatch'}), h('span'), h('b'), h('small'), row.remove
        && h('button', {class: 'link', title: 'Remove',
          ariaLabel: `Remove ${row.name}`, onclick: row.remove}, '\u00d7')), (item, row) => {
        set(item.firstChild, 'data-line', row.index % 4);
        say(item.children[1], row.name);
        say(item.children[2], written(row) + (row.value ? when : '') + (row.difference
          ? `, \u0394 ${written({...row, value: row.difference})} in ${spanText(s - mark)}` : ''));
        say(item.children[3], row.note ?? '');
      });
    const text = rows.map((row) => `${row.name} ${written(row)}`).join(', ');
    if (text !== this.#drawn) {
      set(this.canvas, 'aria-label', `${this.label}: ${this.#drawn = text}`);
    }
  }
}

const times = (factor) => (value) => value === null ? null : factor * value;

const isWithin = (s, [from, to]) => s !== null && s >= from && s <= to;

/** What makes two series differ: the name, and whether there is a point. */
const nameOf = ({name, points}) => `${name} ${points.length > 0}`;

/** The text of a value of readAt(). */
export function written({value, unit}) {
  if (!value) return 'no data';
  const {low, high, isBetween} = value;
  if (!isInRange(low) || !isInRange(high)) return 'out of range';
  const number = low !== high ? `${measured(low, unit)} to ${measured(high, unit)}`
    : isBetween ? `\u2248 ${measured(low, unit)}` : measured(low, unit);
  return withUnit(number, unit);
}

/** A range after a turn of the wheel: wider or narrower around a time; with Shift it moves. */
export function turned([from, to], at, {deltaX, deltaY, deltaMode, shiftKey}, [first, last]) {
  const isMove = shiftKey || Math.abs(deltaX) > Math.abs(deltaY);
  const delta = Math.abs(deltaX) > Math.abs(deltaY) ? deltaX : deltaY;
  const turn = Math.max(-1, Math.min(1, deltaMode ? delta : delta / 100));
  const span = Math.min(last - first,
    Math.max(LEAST_SPAN_S, (to - from) * (isMove ? 1 : 1.25 ** turn)));
  const wanted = isMove ? from + 0.1 * turn * span : at - (at - from) * span / (to - from);
  const begin = Math.max(first, Math.min(last - span, wanted));
  return [begin, begin + span];
}

/** The points from one time to another, and one more on either side. */
function within(points, from, to) {
  const first = before(points, from);
  const last = before(points, to);
  return points.slice(Math.max(0, first - 1), last + 1);
}

/** How many points are before a time. */
function before(points, s) {
  let low = 0;
  let high = points.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (points[middle][0] < s) low = middle + 1;
    else high = middle;
  }
  return low;
}
