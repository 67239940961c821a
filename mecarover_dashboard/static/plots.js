// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// Plots of the same time, one below the other: the cursor is at one time in all of them.

import {each, h} from './dom.js';

export class Plots {
  #plots = new Map();

  /** make(item) -> a Plot; onCursor(cursor) after a pointer moved it in one of them, as in Plot. */
  constructor(make, onCursor) {
    Object.assign(this, {make, onCursor});
    this.element = h('div', {class: 'graphs'});
  }

  get size() { return this.#plots.size; }

  [Symbol.iterator]() { return this.#plots.values(); }

  /** Show a plot for each item; show(plot, item, its element). Those of other items go. */
  update(items, keyOf, show) {
    each(this.element, items, keyOf, (item) => this.#add(keyOf(item), this.make(item)),
      (element, item) => show(this.#plots.get(keyOf(item)), item, element));
    const wanted = new Set(items.map(keyOf));
    for (const [key, plot] of this.#plots) {
      if (wanted.has(key)) continue;
      plot.close();
      this.#plots.delete(key);
    }
  }

  #add(key, plot) {
    this.#plots.set(key, plot);
    plot.onCursor = (cursor) => {
      for (const other of this) if (other !== plot) other.point(cursor);
      this.onCursor(cursor);
    };
    return plot.element;
  }

  /** Put all cursors so many seconds before the right edge; null: nowhere. */
  point(cursor) { for (const plot of this) plot.point(cursor); }

  mark(s) { for (const plot of this) plot.mark(s); }

  close() { for (const plot of this) plot.close(); }
}
