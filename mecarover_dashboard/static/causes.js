// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// The list of events, grouped by cause: how often, when first and last; opened, each of them.

import {each, h, icon, say, sayWords, set, showState} from './dom.js';
import {clock, list, plural} from './format.js';
import {LEVELS, worst} from './store.js';

export const GAP = 'gap';      // the kind of an event: nothing was recorded
const OF_DEVICE = /^(\d{3}): ([^]*)$/;          // the text of an error
const OF_SOURCE = /: (\d{3})\b/;                // the name of a device
const LOSS_S = 10;             // answers missed so long before a device is lost are part of that
const nameOf = (name) => name.replace(/^.*?: /, '');
const stateOf = ([, , , , level]) => LEVELS[level] ?? 'stale';
const isEnd = ([, , , kind, level]) => kind === 'over' || (kind === 'state' && level === 0);

/**
 * Events [at, name, robot, kind, level, text], the newest first, by cause: [{key, state, who, text,
 * count, first, begin, end, events}, ...]; begin and end are those of the last time, end is null
 * while it lasts. A cause may have several devices, and figures that change. To it belong that a
 * device is well again, and the answers missed before it was lost. What is later than `until` only
 * says when a cause ended.
 */
export function causesOf(events, until = Infinity) {
  const causes = new Map();
  const open = new Map();      // the cause of the state that each source is in, where that is not OK
  const lossOf = lossesOf(events);
  for (const event of [...events].reverse()) {
    const [at, name, robot, kind] = event;
    const source = `${robot} ${name} ${kind === 'state' ? '' : causeOf(event)}`;
    const before = open.get(source);
    const isLater = at > until;
    if (!isLater) {
      const begun = lossOf(event) ?? event;
      const key = isEnd(event) && before?.key || `${robot} ${causeOf(begun)}`;
      if (!causes.has(key)) {
        causes.set(key, {key, kind: begun[3], events: [], open: new Set(), begin: at, end: null});
      }
      const cause = causes.get(key);
      cause.events.unshift(event);
      if (!isEnd(event) && kind === cause.kind && !cause.open.size) cause.begin = at;
      if (isEnd(event) || kind === 'error' || kind === GAP) {
        open.delete(source);
      } else {
        open.set(source, cause);
        cause.open.add(source);
      }
    } else {
      open.delete(source);
    }
    if (!before || before === open.get(source)) continue;
    before.open.delete(source);
    if (!before.open.size) before.end = at;
  }
  return [...causes.values()].map(summary).sort((a, b) => b.begin - a.begin);
}

/** A function from an error to the loss of its device soon after; undefined: there is none. */
function lossesOf(events) {
  const losses = new Map();
  for (const event of events) {
    const [, id] = OF_SOURCE.exec(event[1]) ?? [];
    if (!id || event[3] !== 'state' || isEnd(event)) continue;
    const key = `${event[2]} ${id}`;
    losses.set(key, [...losses.get(key) ?? [], event]);
  }
  return ([at, , robot, kind, , text]) => kind !== 'error' ? undefined
    : losses.get(`${robot} ${OF_DEVICE.exec(text)?.[1]}`)
      ?.find(([lost]) => lost >= at && lost - at < LOSS_S);
}

/** What events of one cause have in common. */
function causeOf([, , , kind, , text]) {
  if (kind === 'finding') return `finding ${text.split(': ')[0]}`;
  if (kind === 'over') return `finding ${text}`;
  if (kind === GAP) return GAP;
  return `${kind} ${(OF_DEVICE.exec(text)?.[2] ?? text).replace(/\d+([.,]\d+)?/g, '#')}`;
}

function summary({key, kind: ofAll, events, open, begin, end}) {
  const begins = events.filter((event) => !isEnd(event) && event[3] === ofAll);
  const some = begins.length ? begins : events;
  const who = [...new Set(some.map(([, name, , kind, , text]) =>
    kind === 'error' && OF_DEVICE.exec(text)?.[1] || nameOf(name)))].sort();
  const [, , , kind, , text] = some[0];
  return {key, events, who, count: some.length, state: worst(some.map(stateOf)),
    text: kind === 'error' && OF_DEVICE.exec(text)?.[2] || (kind === 'over' ? spelt(some[0]) : text),
    first: some.at(-1)[0], begin, end: open.size ? null : end};
}

const spelt = ([, , , kind, , text]) => kind === 'over' ? `ended: ${text}` : text;

export class EventList {
  /** hrefOf(at, name): the address of what happened to a source, null: to all, around a time. */
  constructor(hrefOf, of) {
    Object.assign(this, {hrefOf, of});
    this.element = h('ol', {class: 'events', tabindex: 0, ariaLabel: 'Events'});
  }

  /** Show events, the newest first, up to a time; now: Unix s. */
  update(events, now, until = Infinity) {
    this.now = now;
    const items = causesOf(events, until);
    each(this.element, items.length ? items : [{key: '', events: []}],
      ({key, events: {length}}) => `${key} ${Math.min(2, length)}`,
      ({events: {length}}) => length > 1 ? this.#makeCause() : length ? makeEvent()
        : h('li', {class: 'quiet'}, 'No events in this time.'),
      (item, cause) => {
        if (cause.events.length > 1) this.#showCause(item, cause);
        else if (cause.events.length) this.#showEvent(item, cause.events[0], this.#lengthOf(cause));
      });
  }

  #makeCause() {
    const item = h('li', {}, h('details', {ontoggle: () => this.#showOpen(item)}, h('summary', {},
      icon('ok'), h('time'), h('b'), h('span'), h('small')), h('ol')));
    return item;
  }

  #showCause(item, cause) {
    const [, time, who, text, often] = item.firstChild.firstChild.children;
    item.events = cause.events;
    showState(item.firstChild.firstChild, cause.state);
    say(time, clock(cause.begin, this.now));
    say(who, list(cause.who));
    sayWords(text, cause.text);
    say(often, this.#lengthOf(cause));
    this.#showOpen(item);
  }

  /** '3 times, first 14:02:07, until 14:05:20' */
  #lengthOf({count, first, begin, end}) {
    return [count > 1 && plural(count, 'time'),
      count > 1 && first < begin && `first ${clock(first, this.now)}`,
      end !== null && `until ${clock(end, this.now)}`].filter(Boolean).join(', ');
  }

  #showOpen(item) {
    const [{open}, lines] = [item.firstChild, item.firstChild.lastChild];
    each(lines, open ? item.events.map((event, index) => ({event, index})) : [],
      ({index}) => index, makeEvent, (line, {event}) => this.#showEvent(line, event));
  }

  #showEvent(item, event, length = '') {
    const [, time, link, words, often] = item.children;
    const [at, name] = event;
    showState(item, stateOf(event));
    set(time, 'href', this.hrefOf(at, this.of));
    say(time.firstChild, clock(at, this.now));
    set(link, 'href', name && this.hrefOf(at, name));
    link.hidden = !name;
    say(link, nameOf(name));
    sayWords(words, spelt(event));
    say(often, length);
  }
}

const makeEvent = () => h('li', {}, icon('ok'), h('a', {}, h('time')), h('a'), h('span'),
  h('small'));
