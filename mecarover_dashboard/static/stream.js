// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// The stream of changes: opened again by itself whenever it ends, falls silent, or the page wakes.

const SILENT_MS = 3500;       // the server speaks every second
const RETRY_MS = 1000;

export class Stream {
  #source = null;
  #watch = '';
  #values = false;
  #since = '';
  #heard = 0;
  #retry = 0;

  /** onEvent(data) for each event; onState(live, silent for s, why) each 0.5 s and on a change. */
  constructor(onEvent, onState) {
    this.onEvent = onEvent;
    this.onState = onState;
    this.lostAt = null;
    this.why = '';             // what the server says about it
    document.addEventListener('visibilitychange',
      () => document.hidden ? this.#close() : this.#open());
    addEventListener('pagehide', () => this.#close());
    addEventListener('online', () => this.#open());
    setInterval(() => this.#check(), 500);
    this.#open();
  }

  /** Ask for the table of a device too, '' for none; and for the values of all devices. */
  watch(name, values) {
    if (name === this.#watch && values === this.#values) return;
    this.#watch = name;
    this.#values = values;
    this.#open();
  }

  #open() {
    this.#close();
    if (document.hidden) return;
    const query = new URLSearchParams();
    if (this.#watch) query.set('watch', this.#watch);
    if (this.#values) query.set('values', '1');
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
      this.why = '';
      this.onState(true, 0, '');
    }
  }

  #fail() {
    this.#close();
    this.lostAt ??= this.#heard;
    this.live = false;
    this.#tell();
    this.#retry = setTimeout(() => this.#open(), RETRY_MS);
    this.#ask();
  }

  #tell() { this.onState(false, (performance.now() - this.lostAt) / 1000, this.why); }

  /** An EventSource hides the answer of the server: ask again, to tell the reason. */
  async #ask() {
    try {
      const answer = await fetch('events', {method: 'HEAD', cache: 'no-store'});
      this.why = answer.headers.get('X-Reason') ?? '';
    } catch {
      this.why = '';           // no server at all
    }
    if (!this.live) this.#tell();
  }

  #check() {
    if (document.hidden) return;
    if (this.#source && performance.now() - this.#heard > SILENT_MS) this.#fail();
    else if (this.lostAt !== null) this.#tell();
  }
}
