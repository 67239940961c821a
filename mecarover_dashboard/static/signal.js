// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// Chosen registers, value by value, and differences of them: asked for again and again, kept for a
// minute, thinned to what a plot can show, written as CSV.

export const MOST = 8;
export const SPAN_S = 60;
const EVERY_MS = 100;
const RETRY_MS = 1000;         // the page says itself that the server is lost
const LEAST_GAP_S = 0.02;
const INTERVALS = 500;         // so many of the newest say what is usual between two values
const SAME_S = 1e-6;           // less than the clock of the values can tell apart
const RATE_S = 5;              // the rate is that of the last so many seconds

/** One register of one device; its points lie in `data` as s, value, s, value ... */
export class Signal {
  data = new Float64Array(2048);
  begin = 0;                   // where the oldest point is, in data
  end = 0;
  gap = Infinity;              // s without a value: longer than usual
  isWritten = false;           // what the master writes holds until it writes again
  next = 0;                    // number of the first point that is not here

  constructor(device, key) { Object.assign(this, {device, key}); }

  take(isWritten, first, points) {
    if (first !== this.next) this.begin = this.end = 0;        // others than those here
    Object.assign(this, {isWritten, next: first + points.length / 2});
    if (this.end + points.length > this.data.length) this.#makeRoom(points.length);
    this.data.set(points, this.end);
    this.end += points.length;
    if (points.length) this.gap = this.#usual();
  }

  #makeRoom(more) {
    const kept = this.data.subarray(this.begin, this.end);
    const size = 2 * (kept.length + more);
    const data = size > this.data.length ? new Float64Array(size) : this.data;
    data.set(kept, 0);
    Object.assign(this, {data, begin: 0, end: kept.length});
  }

  /** Three times what 95 % of the intervals between values keep to. */
  #usual() {
    const from = Math.max(this.begin, this.end - 2 * INTERVALS);
    const lengths = new Float64Array(Math.max(0, (this.end - from) / 2 - 1));
    lengths.forEach((_, at) => {
      lengths[at] = this.data[from + 2 * at + 2] - this.data[from + 2 * at];
    });
    lengths.sort();
    return lengths.length
      ? Math.max(LEAST_GAP_S, 3 * lengths[Math.floor(0.95 * (lengths.length - 1))]) : Infinity;
  }

  forget(before) { this.begin = this.indexOf(before); }

  /** Where in data the first point is that is not before a time. */
  indexOf(s) {
    let [low, high] = [this.begin / 2, this.end / 2];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.data[2 * middle] < s) low = middle + 1;
      else high = middle;
    }
    return 2 * low;
  }

  /** The value at this very time, as a point; null: there is none. */
  pointAt(s) {
    const at = this.indexOf(s - SAME_S);
    const [time, value] = at < this.end ? this.data.subarray(at, at + 2) : [Infinity];
    return time <= s + SAME_S && Number.isFinite(value) ? [time, value] : null;
  }

  /** When the next value is, after a time (by: 1) or before it (-1); null: never. */
  beside(s, by) {
    const at = by > 0 ? this.indexOf(s + SAME_S) : this.indexOf(s - SAME_S) - 2;
    return at >= this.begin && at < this.end ? this.data[at] : null;
  }

  /** Values per second, lately. */
  rate(now) {
    const count = (this.end - this.indexOf(now - RATE_S)) / 2;
    return count && count / Math.min(RATE_S, now - this.data[this.begin]);
  }

  /**
   * {count, rate, low, high, mean, rms, deviation} of the values from one time to another; rate: per
   * second; deviation: of the sample. What was written before counts for low and high: it holds.
   */
  statistics(from, to) {
    let [count, mean, squares, low, high] = [0, 0, 0, Infinity, -Infinity];
    const first = this.indexOf(from);
    const held = this.isWritten ? 2 : 0;
    for (let at = Math.max(this.begin, first - held); at < this.end && this.data[at] <= to; at += 2) {
      const value = this.data[at + 1];
      if (!Number.isFinite(value)) continue;
      [low, high] = [Math.min(low, value), Math.max(high, value)];
      if (at < first) continue;
      const error = value - mean;
      mean += error / ++count;
      squares += error * (value - mean);
    }
    const rate = count && count / (to - Math.max(from, this.data[this.begin]));
    return {count, rate, low, high, mean, rms: Math.sqrt(mean ** 2 + squares / Math.max(1, count)),
      deviation: Math.sqrt(squares / Math.max(1, count - 1))};
  }

  /**
   * What a plot so many pixels wide can show: [[s, lowest, highest, last], ...] of each column;
   * [s, null] at a gap. A value that was written is held until the next.
   */
  drawn(from, to, width, now) {
    const {data, end, isWritten} = this;
    const step = (to - from) / width;
    const gap = isWritten ? Infinity : Math.max(this.gap, 2 * step);
    const columns = new Columns(step);
    let [s, value] = [NaN, NaN];
    for (let at = Math.max(this.begin, this.indexOf(from) - 2); at < end && !(s > to); at += 2) {
      if (isWritten) columns.hold(data[at], value);
      else if (data[at] - s > gap) columns.interrupt(s + step);
      [s, value] = [data[at], data[at + 1]];
      columns.put(s, value);
    }
    if (isWritten && s < to) columns.hold(Math.min(now, to), value);
    else if (now - s > gap) columns.interrupt(s + step);
    return columns.end();
  }
}

/** One register minus another, at the times of what was read. */
export class Difference extends Signal {
  constructor(one, other) {
    super(one.device, one.key);
    this.parts = [one, other];
  }

  update() {
    const [one, other] = this.parts;
    this.isWritten = one.isWritten && other.isWritten;
    const base = one.isWritten ? other : one;
    const times = this.isWritten ? Float64Array.from([...timesOf(one), ...timesOf(other)]).sort()
      : timesOf(base);
    const [first, second] = [valueOf(one), valueOf(other)];
    const data = new Float64Array(2 * times.length);
    times.forEach((s, at) => {
      data[2 * at] = s;
      data[2 * at + 1] = first(s) - second(s);
    });
    Object.assign(this, {data, begin: 0, end: data.length, gap: base.gap});
  }
}

const timesOf = ({data, begin, end}) =>
  Float64Array.from({length: (end - begin) / 2}, (_, at) => data[begin + 2 * at]);

/** A function that gives the value at a time, each later than the last one: NaN where unknown. */
function valueOf({data, begin, end, gap, isWritten}) {
  let at = begin;
  return (s) => {
    while (at + 2 < end && data[at + 2] <= s) at += 2;
    const isNextNearer = !isWritten && at + 2 < end && data[at + 2] - s < s - data[at];
    const near = isNextNearer ? at + 2 : at;
    const isKnown = begin < end
      && (isWritten ? data[near] <= s : Math.abs(data[near] - s) <= gap);
    return isKnown ? data[near + 1] : NaN;
  };
}

class Columns {
  points = [];
  #open = null;                // the column that is being filled
  #isAlone = false;            // it is the only one since a gap

  constructor(step) { this.step = step; }

  #isIn(s) {
    return this.#open && Math.floor(s / this.step) === Math.floor(this.#open[0] / this.step);
  }

  /** Go on with a value up to where the next begins. */
  hold(s, value) {
    if (!this.#open || this.#isIn(s)) return;
    this.#isAlone = false;
    this.points.push(this.#open = [s, value, value, value]);
  }

  put(s, value) {
    const open = this.#open;
    if (!Number.isFinite(value)) {
      this.interrupt(s);
    } else if (this.#isIn(s) && s > open[0]) {
      if (value < open[1]) open[1] = value;
      if (value > open[2]) open[2] = value;
      open[3] = value;
    } else {
      this.#isAlone = !open;
      this.points.push(this.#open = [s, value, value, value]);
    }
  }

  interrupt(s) {
    if (!this.#open) return;
    this.#dot(s);
    this.points.push([s, null]);
    this.#open = null;
  }

  /** Make a value that is alone wide enough to be seen. */
  #dot(s) { if (this.#isAlone) this.points.push([s, ...this.#open.slice(1)]); }

  end() {
    if (this.#open) this.#dot(this.#open[0] + this.step);
    return this.points;
  }
}

/**
 * The points of some signals as CSV: a line for each time, as timeOf(s) writes it, a column for each
 * signal, its numbers as exact as they are and with a point.
 */
export function csvOf(signals, names, [from, to], timeName, timeOf) {
  const lines = [[timeName, ...names].map(cellOf).join()];
  const at = signals.map((signal) => signal.indexOf(from));
  const next = (signal, index) => at[index] < signal.end ? signal.data[at[index]] : Infinity;
  for (;;) {
    const s = Math.min(...signals.map(next));
    if (!(s <= to)) return `${lines.join('\n')}\n`;
    lines.push([timeOf(s), ...signals.map((signal, index) => {
      if (next(signal, index) !== s) return '';
      const value = signal.data[at[index] + 1];
      at[index] += 2;
      return Number.isFinite(value) ? value : '';
    })].join());
  }
}

/** A text as a cell; a spreadsheet must not take it for a formula. */
function cellOf(text) {
  const plain = /^\s*[=+@-]/.test(text) ? `'${text}` : text;
  return /[,\n\x22]/.test(plain) ? `\x22${plain.replaceAll('\x22', '\x22\x22')}\x22` : plain;
}

/** Asks the server for the values of some signals, as long as it is open. */
export class Signals {
  all = [];
  now = 0;                     // s on the clock of the values
  origin = 0;                  // what to add to them
  #turn = 0;                   // number of the round of questions; 0: closed

  /** onValues() when some have come; onProblem(text) when not, '' when that is over. */
  constructor(onValues, onProblem) { Object.assign(this, {onValues, onProblem}); }

  get isOpen() { return this.#turn > 0; }

  /** Begin again, with all points of the last minute. */
  open() { this.#ask(this.#turn = performance.now()); }

  close() { this.#turn = 0; }

  /** Get the past of what has no points yet, while it is closed. */
  async fill() {
    const some = this.all.filter(({next}) => !next);
    if (!some.length || this.isOpen) return;
    try {
      this.#take(some, await this.#fetch(some));
    } catch (error) {
      this.onProblem(error.message);
    }
  }

  async #ask(turn) {
    const {all} = this;
    let rest = EVERY_MS;
    try {
      if (all.length && !document.hidden) {
        const numbers = await this.#fetch(all);
        if (turn !== this.#turn) return;
        this.#take(all, numbers);
      }
      this.onProblem('');
    } catch (error) {
      rest = RETRY_MS;
      if (turn === this.#turn) this.onProblem(error instanceof TypeError ? '' : error.message);
    }
    setTimeout(() => turn === this.#turn && this.#ask(turn), rest);
  }

  async #fetch(all) {
    const query = new URLSearchParams(all.flatMap(({device, key, next}) =>
      [['of', device], ['register', key], ['after', next]]));
    const answer = await fetch(`signals?${query}`, {cache: 'no-store'});
    if (!answer.ok) throw new Error((await answer.text()).trim());
    return new Float64Array(await answer.arrayBuffer());
  }

  #take(all, numbers) {
    if (this.isOpen || !this.now) [this.now, this.origin] = numbers;
    let at = 2 + 3 * all.length;
    all.forEach((signal, index) => {
      const [kind, first, count] = numbers.subarray(2 + 3 * index);
      if (kind) signal.take(kind === 2, first, numbers.subarray(at, at + 2 * count));
      at += 2 * count;
      signal.forget(this.now - SPAN_S);
    });
    this.onValues();
  }
}
