// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// What the devices and buses of a robot were at a time of the history: a card each, the worst first.

import {each, h, icon, say, sayWords, set, showState} from './dom.js';
import {clock} from './format.js';
import {written} from './plot.js';
import {LEVELS, WORDS, worstFirst} from './store.js';
import {shownIn} from './units.js';

const UNITS = {temperature: '\u00b0C', voltage: 'V', loss: '%', latency: 'ms',
  bus_load: '%', packet_rate: '1/s', error_rate: '1/s'};
const MOST = 40;

/** The unit of a value of a source, as it is recorded. */
export const unitOf = (name, source) => UNITS[name]
  ?? (name === 'position' ? source.position_unit || 'rad' : source.unit);

export class HistoryCards {
  /** hrefOf(at, name): the address of a source at a time. */
  constructor(hrefOf) {
    this.hrefOf = hrefOf;
    this.heading = h('h2');
    this.list = h('ul', {class: 'servos'});
    this.rest = h('p', {class: 'quiet'});
    this.element = h('section', {class: 'then', hidden: ''}, this.heading, this.list, this.rest);
  }

  /** sources: of /history/values, up to `at` (Unix s); textOf(name): what is known of a state. */
  show(sources, at, textOf) {
    const cards = Object.entries(sources).map(([name, source]) => cardOf(name, source))
      .sort((a, b) => worstFirst(a.state, b.state) || (a.name < b.name ? -1 : 1));
    say(this.heading, `At ${clock(at)}`);
    each(this.list, cards.slice(0, MOST), ({name}) => name, makeCard, (item, card) => {
      set(item.firstChild, 'href', this.hrefOf(at, card.name));
      showCard(item, card, card.state === 'ok' ? '' : textOf(card.name) ?? WORDS[card.state]);
    });
    say(this.rest, !cards.length ? 'Nothing was recorded at this time.'
      : cards.length > MOST ? `and ${cards.length - MOST} more` : '');
  }
}

/** The newest of each value; none is known where its window has no more of it. */
function cardOf(name, source) {
  const [last, level] = source.levels.at(-1);
  const values = Object.entries(source.values).flatMap(([key, points]) => {
    const [s, low, high] = points.at(-1) ?? [];
    if (s !== last) return [];
    const [unit, factor] = shownIn(unitOf(key, source));
    return [{name: key[0].toUpperCase() + key.slice(1).replaceAll('_', ' '),
      text: written({value: {low: factor * low, high: factor * high}, unit})}];
  });
  return {name, state: LEVELS[level] ?? 'stale', values};
}

const makeCard = ({name}) => h('li', {}, h('a', {class: 'servo'},
  h('p', {class: 'servo-head'}, icon('ok'), h('span', {}, name.replace(/^.*?: /, ''))),
  h('p', {class: 'servo-text'}), h('div')));

function showCard(item, {state, values}, words) {
  const [head, text, lines] = item.firstChild.children;
  set(item.firstChild, 'data-state', state);
  showState(head, state);
  sayWords(text, words);
  text.hidden = !words;
  each(lines, values, ({name}) => name,
    ({name}) => h('p', {class: 'measure'}, h('span', {}, name), h('span')),
    (line, value) => say(line.lastChild, value.text));
}
