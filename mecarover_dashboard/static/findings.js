// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// What the doctor found about buses and their devices: a list that can be stopped.

import {each, h, icon, say, sayWords, set, showState} from './dom.js';
import {clock} from './format.js';
import {makeRemedy, showRemedy, spelt} from './finding.js';
import {panel} from './parts.js';
import {path} from './place.js';
import {deviceName, isQuiet, worstFirst} from './store.js';

export class FindingList {
  /** A heading (text or an element) above the list, more elements below it; the view's Pause. */
  constructor(heading, pause, ...below) {
    this.pause = pause;
    this.none = h('p', {class: 'quiet'}, 'Nothing found.');
    this.list = h('ul', {class: 'findings'});
    this.element = panel(heading, this.none, this.list, ...below);
  }

  /**
   * List the findings of buses and their devices, errors first, equal ones once; return how many.
   * isSaid(text, device) leaves out what the view shows elsewhere.
   */
  update(groups, store, isSaid = () => false) {
    const found = groups.flatMap(({row, part, devices}) => [
      ...(row?.findings ?? []).map((finding) => ({finding, row, part, device: null})),
      ...devices.flatMap((device) => device.findings
        .map((finding) => ({finding, row: device, part, device})))])
      .filter(({finding, device}) => !isSaid(finding[1], device))
      .sort((a, b) => worstFirst(a.finding[2], b.finding[2]));
    if (!this.pause.isOn) this.#show(merged(found), store);
    return this.list.childElementCount;
  }

  #show(found, store) {
    this.none.hidden = found.length > 0;
    each(this.list, found,
      ({finding, row, devices}) => [finding[0], row.name, ...devices.map(({id}) => id)].join('|'),
      ({devices}) => makeFinding('warn', devices),
      (item, {finding, row, part}) => showFinding(item, finding, wasTrue(row, part, store)));
  }
}

/** What several devices of a bus have is one finding, of all of them. */
function merged(found) {
  const all = new Map();
  for (const {device, ...one} of found) {
    const key = `${one.part.row_name}|${one.finding}`;
    if (!all.has(key)) all.set(key, {...one, devices: []});
    if (device) all.get(key).devices.push(device);
  }
  return [...all.values()];
}

/** An item for one finding: icon, rule, message, what to do, and links to its devices. */
export const makeFinding = (name, devices = []) => h('li', {}, icon(name), h('b'), h('span'),
  h('p', {}, makeRemedy(), ...devices.map(
    (one) => h('a', {href: path('device', one.name)}, deviceName(one)))));

/** Fill an item made by makeFinding; `old` says when it was true, '' while it is. */
export function showFinding(item, [rule, message, severity], old = '') {
  showState(item, severity);
  set(item, 'data-old', old !== '');
  say(item.children[1], spelt(rule));
  sayWords(item.children[2], old ? `${message} (${old})` : message);
  showRemedy(item.lastChild.firstChild, rule);
}

/** 'at 14:02:11, no report since' of a row that is no longer of now; '' of others. */
export const wasTrue = (row, part, store) => isQuiet(row)
  ? `at ${clock(store.wall(row.quiet_since))}, no report since`
  : part.is_known ? '' : `before: ${part.mark}`;
