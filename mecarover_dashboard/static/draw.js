// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// The drawing of a plot: scale, grid, limits, lines. It knows no events and no time but its own.

import {clock, figure, isInRange, span} from './format.js';
import {GAP_S} from './store.js';
import {measured} from './units.js';

const LEFT = 52, RIGHT = 10, TOP = 8, BOTTOM = 20;
const STEPS = [1, 2, 2.5, 5, 10];
const TIMES = [10, 20, 30, 60, 120, 300, 600, 1200, 1800, 3600, 7200, 14400, 21600];      // s
const DASHES = [[], [6, 3], [2, 3], [9, 3, 2, 3]];
const LIMIT_DASH = [4, 4];
const DOTS = 10;               // px from one point to the next, from which each has a dot
const DENSE = 400;             // points: dashes would not be seen, and thin lines are drawn soon

/** Draw series into a canvas; return where the lines are, {left, width}; null: it is not seen. */
export function drawPlot(canvas, shown, view) {
  const {clientWidth: width, clientHeight: height} = canvas;
  if (!width || !height) return null;
  const scale = devicePixelRatio || 1;
  const size = [Math.round(width * scale), Math.round(height * scale)];
  if (canvas.width !== size[0]) canvas.width = size[0];
  if (canvas.height !== size[1]) canvas.height = size[1];
  const pen = canvas.getContext('2d');
  const colours = coloursOf(canvas);
  pen.setTransform(scale, 0, 0, scale, 0, 0);
  pen.clearRect(0, 0, width, height);
  const area = {left: LEFT, top: TOP, width: width - LEFT - RIGHT, height: height - TOP - BOTTOM};
  const ticks = ticksOf(...rangeOf(shown, view), Math.max(4, Math.floor(area.height / 30)));
  const at = {
    x: (s) => area.left + area.width * (s - view.from) / (view.to - view.from),
    y: (value) => area.top + area.height
      * (1 - (bounded(value, ticks) - ticks.low) / (ticks.high - ticks.low)),
  };
  drawGrid(pen, area, at, ticks, view, colours);
  pen.save();
  pen.beginPath();
  pen.rect(area.left, 0, area.width + RIGHT, height);
  pen.clip();
  for (const [name, value] of view.limits ?? []) {
    drawLimit(pen, area, at, `${name} ${measured(value, view.unit)}`, value, ticks, colours);
  }
  shown.forEach((one, index) => one.step
    ? drawBand(pen, one, at, colours.lines[index % 4])
    : drawLine(pen, one.points, at,
      {colour: colours.lines[index % 4], dash: DASHES[index % 4],
        hasDots: one.hasDots && (one.isSampled || isSparse(one.points, at)),
        isSampled: one.isSampled}, view));
  pen.restore();
  if (view.drag) drawDrag(pen, area, at, view.drag, colours);
  if (view.mark !== null) drawUpright(pen, area, at.x(view.mark), colours, LIMIT_DASH);
  if (view.cursor !== null) drawCursor(pen, area, at, shown, view, colours);
  return area;
}

const isSparse = (points, at) => points.length > 0
  && at.x(points.at(-1)[0]) - at.x(points[0][0]) >= DOTS * (points.length - 1);

/** A value that no scale can hold goes to the edge. */
function bounded(value, {low, high}) {
  const margin = high - low;
  return Math.min(high + margin, Math.max(low - margin, value));
}

function coloursOf(canvas) {
  const style = getComputedStyle(canvas);
  const get = (name) => style.getPropertyValue(name).trim();
  return {grid: get('--line'), label: get('--muted'), text: get('--text'), limit: get('--error'),
    lines: ['--plot-0', '--plot-1', '--plot-2', '--plot-3'].map(get)};
}

/**
 * What the line shows at a time: {low, high, at, isBetween}; at the end where the time is null;
 * null: nothing. Between two points it is on the line between them: no value that was measured.
 * Of a band (`step`) it is what the step of that time has. pointAt(s): the point that was thinned
 * out and is at this very time, or null.
 */
export function readAt(points, s, near,
  {gap = GAP_S, step = 0, isSampled = false, pointAt = () => null} = {}) {
  const exact = s === null ? null : pointAt(s);
  if (exact) return at(exact);
  const after = s === null ? points.length : points.findIndex((point) => point[0] >= s);
  const [left, right] = [points.at(after < 0 ? -1 : after - 1), points[after]];
  const isLeft = after !== 0 && left && left[1] !== null;
  if (s === null) return isLeft ? at(left[3] === undefined ? left : [left[0], left[3]]) : null;
  if (step) return isLeft && s - left[0] <= (right ? step : gap) ? {...at(left), at: s} : null;
  const isRight = right && right[1] !== null;
  const nearer = isRight && (!isLeft || right[0] - s <= s - left[0]) ? right : isLeft && left;
  if (nearer && Math.abs(nearer[0] - s) <= near) return at(nearer);
  if (isSampled && isLeft) return at(left);
  if (isLeft && isRight && right[0] - left[0] < gap) {
    const from = left[2] ?? left[1];
    const value = from + (right[1] - from) * (s - left[0]) / (right[0] - left[0]);
    return {low: value, high: value, at: s, isBetween: from !== right[1]};
  }
  return isLeft && !right && s - left[0] <= gap ? at(left) : null;
}

const at = (point) => ({low: point[1], high: point[2] ?? point[1], at: point[0]});

/** From one value that was read to another: as exact as both are; null where one is unknown. */
export const differenceOf = (from, to) => from && to && {low: to.low - from.high,
  high: to.high - from.low, isBetween: from.isBetween || to.isBetween};

function rangeOf(shown, {low: wanted, limits = []}) {
  let low = Infinity;
  let high = -Infinity;
  for (const {points} of shown) {
    for (const [, one, other = one] of points) {
      if (one === null || !isInRange(one) || !isInRange(other)) continue;
      low = Math.min(low, one);
      high = Math.max(high, other);
    }
  }
  if (low > high) return [0, 1];
  // A limit is shown where it costs little: where the line is not flat for its sake.
  const reach = Math.max(high - low, 0.25 * Math.abs(high));
  for (const [, value] of limits) {
    if (value > high && value - high < 2 * reach) high = value;
    if (value < low && low - value < 2 * reach) low = value;
  }
  if (wanted !== undefined && low >= wanted) low = wanted;
  else if (low >= 0 && low < 0.6 * high) low = 0;         // from zero, where that costs little
  const pad = high > low ? 0.06 * (high - low) : Math.max(Math.abs(high) * 0.1, 0.5);
  return [low === 0 || low === wanted ? low : low - pad, high + pad];
}

/** Round ticks that cover a range: {low, high, step}. */
function ticksOf(low, high, count) {
  const raw = (high - low) / count;
  const size = 10 ** Math.floor(Math.log10(raw));
  const step = size * STEPS.find((one) => one * size >= raw * 0.999);
  return {low, high, step, first: Math.ceil(low / step) * step};
}

function drawGrid(pen, area, at, ticks, view, colours) {
  pen.font = '11px system-ui, sans-serif';
  pen.strokeStyle = colours.grid;
  pen.fillStyle = colours.label;
  pen.lineWidth = 1;
  pen.textAlign = 'right';
  pen.textBaseline = 'middle';
  pen.beginPath();
  const largest = Math.max(Math.abs(ticks.low), Math.abs(ticks.high));
  const digits = Math.max(5, 2 + Math.floor(Math.log10(largest / ticks.step)));
  for (let value = ticks.first; value <= ticks.high + ticks.step * 1e-6; value += ticks.step) {
    const y = Math.round(at.y(value)) + 0.5;
    const round = Math.abs(value) < ticks.step * 1e-6 ? 0 : Number(value.toPrecision(9));
    pen.moveTo(area.left, y);
    pen.lineTo(area.left + area.width, y);
    pen.fillText(figure(round, digits).replace('-', '\u2212'), area.left - 6, y);
  }
  pen.textBaseline = 'alphabetic';
  drawTimes(pen, area, at, view);
  pen.stroke();
}

/** Round times: seconds or minutes before now, or hours and minutes of the day. */
function drawTimes(pen, area, at, {from, to, now, unix}) {
  const step = stepOf(to - from, Math.max(3, Math.floor(area.width / 90)));
  const zero = unix ? 60 * new Date(1000 * unix(from)).getTimezoneOffset() - unix(0) : now;
  pen.textAlign = 'center';
  for (let part = Math.ceil((from - zero) / step - 1e-6); ; part++) {
    const s = zero + part * step;
    if (s > to) break;
    const x = Math.round(at.x(s)) + 0.5;
    const text = unix ? clock(unix(s), unix(s)).slice(0, step < 60 ? 8 : 5) : part === 0 ? 'now'
      : `\u2212${step < 60 ? span(-part * step) : `${-part * step / 60} min`}`;
    pen.moveTo(x, area.top + area.height);
    pen.lineTo(x, area.top + area.height + 4);
    const half = pen.measureText(text).width / 2;
    pen.fillText(text, Math.max(half, Math.min(x, area.left + area.width + RIGHT - half)),
      area.top + area.height + 16);
  }
}

/** A round step, of which so many at most cover a time. */
function stepOf(length, most) {
  const least = Math.max(length / most, length > 120 ? 60 : 0) * 0.999;
  const size = 10 ** Math.floor(Math.log10(least));
  const round = least < 5 ? [1, 2, 5, 10].map((one) => one * size) : TIMES;
  return round.find((one) => one >= least) ?? 86400;
}

function drawLimit(pen, area, at, text, value, ticks, colours) {
  if (!(value >= ticks.low && value <= ticks.high)) return;
  const y = Math.round(at.y(value)) + 0.5;
  pen.strokeStyle = pen.fillStyle = colours.limit;
  pen.lineWidth = 1;
  pen.setLineDash(LIMIT_DASH);
  pen.beginPath();
  pen.moveTo(area.left, y);
  pen.lineTo(area.left + area.width, y);
  pen.stroke();
  pen.setLineDash([]);
  pen.textAlign = 'left';
  pen.fillText(text, area.left + 4, y - 4 < 12 ? y + 12 : y - 4);
}

function drawLine(pen, points, at, {colour, dash, hasDots, isSampled}, view) {
  const {now, to, isLive, unix, gap = GAP_S} = view;
  pen.strokeStyle = pen.fillStyle = colour;
  const isDense = points.length > DENSE;
  pen.lineWidth = isDense ? 1 : 1.6;
  pen.lineJoin = isDense ? 'bevel' : 'round';
  pen.setLineDash(isDense ? [] : dash);
  pen.globalAlpha = isSampled ? 0.4 : 1;       // between samples nothing was measured
  const before = strokeLine(pen, points, at, gap, isSampled);
  pen.globalAlpha = 1;
  const isHeld = before && isLive && !unix && now - before[0] > gap;
  if (isHeld) drawHeld(pen, at, before, Math.min(now, to));
  pen.setLineDash([]);
  for (const [s, value] of hasDots ? points : []) {
    if (value !== null) pen.fillRect(at.x(s) - 2, at.y(value) - 2, 4, 4);
  }
}

/** Fill from the lowest to the highest of each step; where a step is missing there is a gap. */
function drawBand(pen, {points, step}, at, colour) {
  pen.strokeStyle = pen.fillStyle = colour;
  pen.lineWidth = 1;
  for (const run of runsOf(points, step)) {
    const edge = (end) => run.flatMap((point) =>
      [0, step].map((after) => [at.x(point[0] + after), at.y(point[end])]));
    pen.beginPath();
    for (const [x, y] of [...edge(2), ...edge(1).reverse()]) pen.lineTo(x, y);
    pen.closePath();
    pen.globalAlpha = 0.3;
    pen.fill();
    pen.globalAlpha = 1;
    pen.stroke();
  }
}

/** Points that follow each other without a gap. */
function runsOf(points, step) {
  const runs = [];
  for (const point of points) {
    const run = runs.at(-1);
    if (run && point[0] - run.at(-1)[0] < 1.5 * step) run.push(point);
    else runs.push([point]);
  }
  return runs;
}

/** Draw what is not interrupted, samples as steps; return the last point, null after a gap. */
function strokeLine(pen, points, at, gap, isSampled) {
  let before = null;
  pen.beginPath();
  for (const point of points) {
    if (point[1] !== null) {
      const x = at.x(point[0]);
      const isOn = before && point[0] - before[0] < gap;
      if (isOn && isSampled) pen.lineTo(x, at.y(before[3] ?? before[1]));
      if (isOn) pen.lineTo(x, at.y(point[1]));
      else pen.moveTo(x, at.y(point[1]));
      if (point[2] !== undefined && point[2] !== point[1]) pen.lineTo(x, at.y(point[2]));
    }
    before = point[1] === null ? null : point;
  }
  pen.stroke();
  return before;
}

/** A value that was not seen since: still the last one known, but no measurement. */
function drawHeld(pen, at, [s, value], to) {
  pen.setLineDash([1, 5]);
  pen.lineWidth = 1.2;
  pen.beginPath();
  pen.moveTo(at.x(s), at.y(value));
  pen.lineTo(at.x(to), at.y(value));
  pen.stroke();
}

function drawDrag(pen, area, at, [from, to], colours) {
  pen.fillStyle = colours.text;
  pen.globalAlpha = 0.12;
  pen.fillRect(at.x(from), area.top, at.x(to) - at.x(from), area.height);
  pen.globalAlpha = 1;
}

/** How near the cursor is to a point that it means, s. */
export const nearOf = ({width}, from, to) => 4 * (to - from) / width;

function drawUpright(pen, {top, height}, x, colours, dash = []) {
  pen.strokeStyle = colours.text;
  pen.lineWidth = 1;
  pen.setLineDash(dash);
  pen.beginPath();
  pen.moveTo(x, top);
  pen.lineTo(x, top + height);
  pen.stroke();
  pen.setLineDash([]);
}

function drawCursor(pen, area, at, shown, {cursor, gap, from, to}, colours) {
  drawUpright(pen, area, at.x(cursor), colours);
  shown.forEach(({points, step, isSampled, pointAt}, index) => {
    const found = readAt(points, cursor, nearOf(area, from, to), {gap, step, isSampled, pointAt});
    if (!found) return;
    pen.fillStyle = colours.lines[index % 4];
    for (const value of step ? [found.low, found.high] : [found.high]) {
      pen.beginPath();
      pen.arc(at.x(found.at), at.y(value), 3.5, 0, 7);
      pen.fill();
    }
  });
}
