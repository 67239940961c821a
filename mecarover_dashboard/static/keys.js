// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// Single keys as shortcuts; they can be switched off, because speech input types them by mistake.

import {path} from './place.js';

const STORED = 'shortcuts';
const at = (id) => document.getElementById(id);

/** Act on keys. view: {step(by), up(), search()}, what the view shown can do. */
export function listenToKeys(view, toggleAngles) {
  const show = (...parts) => { location.hash = path(...parts); };
  const step = (by) => {
    const to = view.step(by);
    if (to) location.replace(to);    // one step back leads out of the devices, not through all
  };
  const keys = {
    ...Object.fromEntries([...document.querySelectorAll('.views a')].map((link, index) =>
      [index + 1, () => { if (!link.hidden) location.hash = link.hash; }])),
    '/': () => {
      const field = view.search();
      if (field) field.focus();
      else show('devices');
    },
    t: () => window.toggleTheme(),
    a: toggleAngles,
    u: () => { location.hash = view.up() ?? path(); },
    '[': () => step(-1), ']': () => step(1),
  };
  addEventListener('keydown', (event) => act(event, keys));
  at('shortcuts').checked = isOn();
  at('shortcuts').addEventListener('change', (event) => keep(event.target.checked));
  at('show-keys').addEventListener('click', () => at('keys').showModal());
}

function act(event, keys) {
  if (event.ctrlKey || event.metaKey || event.altKey || at('keys').open) return;
  if (event.target.matches('input')) {
    if (event.key === 'Escape') event.target.blur();
    return;
  }
  if (!isOn()) return;
  if (event.key === '?') at('keys').showModal();
  else if (Object.hasOwn(keys, event.key)) keys[event.key]();
  else return;
  event.preventDefault();
}

function isOn() {
  try {
    return localStorage.getItem(STORED) !== 'off';
  } catch {
    return true;               // no storage: as it is on the first visit
  }
}

function keep(on) {
  try {
    localStorage.setItem(STORED, on ? 'on' : 'off');
  } catch { /* for this visit nothing can be kept */ }
}
