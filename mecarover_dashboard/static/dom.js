// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// Making and changing elements. What comes from a topic gets in as text, here and nowhere else.

/** Make an element: h('a', {href, class, onclick, ariaLabel}, child or text, ...). */
export function h(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  if (tag === 'button') element.type = tag;      // else it would send a form
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith('on')) element.addEventListener(name.slice(2), value);
    else set(element, name.replace(/^aria[A-Z]/, (it) => `aria-${it[4].toLowerCase()}`), value);
  }
  element.append(...children.filter((child) => child != null));
  return element;
}

/** Set an attribute if that changes anything; null removes it, and false where that says the same. */
export function set(element, name, value) {
  if (value == null || (value === false && name !== 'aria-pressed')) {
    if (element.hasAttribute(name)) element.removeAttribute(name);
  } else if (element.getAttribute(name) !== String(value)) {
    element.setAttribute(name, value);
  }
}

/** Set the text of an element if that changes anything; true if it did. */
export function say(element, text) {
  if (element.textContent === text) return false;
  element.textContent = text;
  return true;
}

/** As say(), of a sentence: what it has between backticks is shown as code. */
export function sayWords(element, text) {
  if (element.words === text) return;
  element.words = text;
  const parts = text.split('`');
  element.replaceChildren(...parts.length % 2
    ? parts.map((part, at) => at % 2 ? h('code', {}, part) : part) : [text]);
}

const SVG = 'http://www.w3.org/2000/svg';

/** Make an SVG element. */
export function svg(tag, attributes = {}, ...children) {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

/** An icon of the sprite in index.html; the text next to it says the same. */
export function icon(name) {
  return svg('svg', {class: 'icon', 'aria-hidden': 'true'}, svg('use', {href: `#i-${name}`}));
}

/** Show a state: its colour, and its icon, made by icon(): the first child, or another one. */
export function showState(element, state, symbol = element.firstChild) {
  set(element, 'data-state', state);
  set(symbol.firstChild, 'href', `#i-${state}`);
}

/**
 * Bring the children of an element in line with a list; what is there stays, in order.
 * make(item) -> element; update(element, item).
 */
export function each(parent, items, keyOf, make, update) {
  const kept = parent.kept ??= new Map();
  const wanted = new Set();
  let next = parent.firstChild;
  for (const item of items) {
    const key = keyOf(item);
    if (wanted.has(key)) continue;
    wanted.add(key);
    let element = kept.get(key);
    if (!element) kept.set(key, element = make(item));
    if (element === next) next = next.nextSibling;
    else parent.insertBefore(element, next);
    update?.(element, item);
  }
  for (const [key, element] of kept) {
    if (!wanted.has(key)) {
      element.remove();
      kept.delete(key);
    }
  }
}
