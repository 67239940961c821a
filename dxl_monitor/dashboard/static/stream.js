// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// The stream of changes: opened again by itself whenever it ends, falls silent, or the page wakes.

const SILENT_MS = 3500;       // the server speaks every second
const RETRY_MS = 1000;

export class Stream {
  #source = null;
  #watch = '';
  #since = '';
  #heard = 0;
  #retry = 0;

  /** onEvent(data) for each event, onState(live, silent for s) once a second and on a change. */
  constructor(onEvent, onState) {
    this.onEvent = onEvent;
    this.onState = onState;
    this.lostAt = null;
    document.addEventListener('visibilitychange', () => document.hidden ? this.#close() : this.#open());
    addEventListener('pagehide', () => this.#close());
    addEventListener('online', () => this.#open());
    setInterval(() => this.#check(), 500);
    this.#open();
  }

  /** Ask for the table of a device too; '' for none. */
  watch(name) {
    if (name === this.#watch) return;
    this.#watch = name;
    this.#open();
  }

  #open() {
    this.#close();
    if (document.hidden) return;
    const query = new URLSearchParams();
    if (this.#watch) query.set('watch', this.#watch);
    if (this.#since) query.set('since', this.#since);
    const source = this.#source = new EventSource(`events?${query}`);
    this.#heard = performance.now();
    source.onmessage = (event) => this.#take(event);
    source.onerror = () => this.#fail();
  }

  #close() {
    clearTimeout(this.#retry);
    this.#source?.close();
    this.#source = null;
  }

  #take(event) {
    this.#heard = performance.now();
    this.#since = event.lastEventId;
    this.onEvent(JSON.parse(event.data));
    if (this.lostAt !== null || !this.live) {
      this.lostAt = null;
      this.live = true;
      this.onState(true, 0);
    }
  }

  #fail() {
    this.#close();
    this.lostAt ??= this.#heard;
    this.live = false;
    this.onState(false, (performance.now() - this.lostAt) / 1000);
    this.#retry = setTimeout(() => this.#open(), RETRY_MS);
  }

  #check() {
    if (document.hidden) return;
    if (this.#source && performance.now() - this.#heard > SILENT_MS) this.#fail();
    else if (this.lostAt !== null) this.onState(false, (performance.now() - this.lostAt) / 1000);
  }
}
