// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// View 8: a finding: what the doctor sees, and what to do; its row of docs/doctor.md.

import {h, sayWords, set} from './dom.js';
import {showCrumbs} from './parts.js';
import {path} from './place.js';
import {RULES} from './rules.js';

/** The name of a rule, in words. */
export const spelt = (rule) => rule.replaceAll('_', ' ');

export class FindingView {
  constructor([rule = '']) {
    this.title = spelt(rule);
    this.crumbs = h('nav', {class: 'crumbs', ariaLabel: 'Place'});
    const [seen, remedy] = isExplained(rule) ? RULES[rule] : ['This version does not know it.', ''];
    this.element = h('div', {}, this.crumbs, h('h1', {tabindex: -1}, this.title),
      h('section', {class: 'panel columns remedy'}, h('div', {}, h('h2', {}, 'Seen'), sentence(seen)),
        h('div', {}, h('h2', {}, 'What to do'), sentence(remedy))));
  }

  update() {
    showCrumbs(this.crumbs, [['Overview', path()], ['Log', path('log')], [this.title, null]]);
  }
}

function sentence(text) {
  const element = h('p');
  sayWords(element, text);
  return element;
}

/** A button that leads to what to do about a finding. */
export const makeRemedy = () => h('a', {class: 'button small'}, 'What to do');

export function showRemedy(button, rule) {
  button.hidden = !isExplained(rule);
  set(button, 'href', path('finding', rule));
  set(button, 'aria-label', `What to do: ${spelt(rule)}`);
}

const isExplained = (rule) => Object.hasOwn(RULES, rule);
