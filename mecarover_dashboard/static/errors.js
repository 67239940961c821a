// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// The last errors of buses, merged by time: a list that can be stopped, because it moves.

import {each, h, say, sayWords, set} from './dom.js';
import {clock} from './format.js';
import {path} from './place.js';
import {deviceName} from './store.js';

const OF_DEVICE = /^(\d{3}): ([^]*)$/;
const CALM_S = 1.5;            // a list that is read does not change more often

/** The errors of buses, the newest first: [{at (Unix s or null), bus, device or null, text}]. */
export function errorsOf(groups, store) {
  const found = groups.flatMap((group) => (group.row?.errors ?? []).map(([at, line]) => {
    const [, id, text] = OF_DEVICE.exec(line) ?? [null, null, line];
    const device = id === null ? null : group.devices.find((one) => one.id === Number(id)) ?? null;
    return {at: store.wall(at), bus: group.label, device, text: device ? text : line,
      isOld: !group.part.is_known};
  }));
  return found.sort((a, b) => (b.at ?? 0) - (a.at ?? 0));
}

export class ErrorList {
  #shown = 0;
  #waiting = [];

  /** A heading (an element) above the list; the view's Pause; `most` lines are shown. */
  constructor(heading, pause, {most = 50, empty = 'No errors.', ofOne = false} = {}) {
    this.most = most;
    this.ofOne = ofOne;
    this.pause = pause;
    this.none = h('p', {class: 'quiet'}, empty);
    this.list = h('ol', {class: 'errors', tabindex: 0, ariaLabel: 'Errors'});
    this.head = h('div', {class: 'head'}, h('h2', {}, heading));
    this.element = h('section', {class: 'panel'}, this.head, this.none, this.list);
  }

  /** Take lines of errorsOf; return how many there are. */
  update(lines, several = false) {
    this.#waiting = lines.slice(0, this.most);
    this.several = several;
    const now = performance.now() / 1000;
    const isDue = now - this.#shown > CALM_S || !this.list.childElementCount;
    if (!this.pause.isOn && isDue) this.#show();
    return lines.length;
  }

  /** Change the texts of lines that stay where they are: nothing jumps. */
  #show() {
    this.#shown = performance.now() / 1000;
    const lines = this.#waiting;
    this.none.hidden = lines.length > 0;
    this.list.hidden = !lines.length;
    each(this.list, lines.map((line, index) => ({...line, index})), ({index}) => index,
      () => h('li', {}, h('time'), h('a'), h('span')), (item, line) => this.#fill(item, line));
  }

  #fill(item, {at, bus, device, text, isOld}) {
    const [time, link, words] = item.children;
    say(time, at === null ? '' : clock(at));
    set(item, 'data-old', isOld);
    const hasLink = device && !this.ofOne;
    link.hidden = !hasLink;
    set(link, 'href', hasLink ? path('device', device.name) : null);
    say(link, hasLink ? deviceName(device) : '');
    sayWords(words, this.several ? `${bus}: ${text}` : text);
  }
}
