// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// The frame around the views: which one is shown, what the header says, keys, the lost connection.

import {BridgeView, bridgeState} from './bridge.js';
import {DeviceView} from './device.js';
import {Devices} from './devices.js';
import {say, set, setIcon} from './dom.js';
import {LogView} from './log.js';
import {Overview} from './overview.js';
import {Store, worst} from './store.js';
import {Stream} from './stream.js';

const VIEWS = {'': Overview, devices: Devices, device: DeviceView, log: LogView, bridge: BridgeView};
const TAB = {'': 'overview', device: 'devices'};
const TICK_MS = 500;           // ages go on while nothing is pushed

const store = new Store();
const at = (id) => document.getElementById(id);
const main = at('main');
let view = null;
let live = true;
let lostText = '';

const stream = new Stream(take, showConnection);

function take(event) {
  const page = store.facts?.page;
  store.apply(event);
  if (page && event.facts && event.facts.page !== page) location.reload();
  if (event.facts) showFacts(event.facts);
  showAll();
}

/** Parse '#/device/NAME' into ['device', 'NAME']. */
function route() {
  try {
    return location.hash.replace(/^#\/?/, '').split('/').map(decodeURIComponent);
  } catch {
    return [''];               // no address of ours
  }
}

function go(isFirst) {
  const [name, ...rest] = route();
  const known = Object.hasOwn(VIEWS, name) && (name !== 'device' || rest[0]) ? name : '';
  view?.close?.();
  view = new VIEWS[known](rest);
  stream.watch(view.watch ?? '');
  main.replaceChildren(view.element);
  const tab = TAB[known] ?? known;
  document.body.dataset.view = known || 'overview';
  for (const link of document.querySelectorAll('[data-view]')) {
    if (link !== document.body) set(link, 'aria-current', link.dataset.view === tab ? 'page' : null);
  }
  scrollTo(0, 0);
  if (!isFirst) (main.querySelector('h1') ?? main).focus({preventScroll: true});
  showAll();
}

function showAll() {
  if (!store.facts) return;
  view.update(store);
  const groups = store.groups();
  const lost = groups.flatMap((group) => group.lost).length;
  const bus = groups.length ? worst(groups.map((group) => group.state)) : null;
  pip('overview', bus);
  pip('bridge', bridgeState(store));
  const text = groups.map((group) => group.headline).join('. ');
  document.title = `${live ? lost ? `\u2716 ${lost} lost \u00b7 ` : '' : 'no connection \u00b7 '}${view.title} \u00b7 ${store.facts.machine}`;
  if (lost !== showAll.lost && showAll.lost !== undefined) say(at('said'), lost ? text : 'No device is lost any more');
  showAll.lost = lost;
}

function pip(name, state) {
  const element = document.querySelector(`[data-pip=${name}]`);
  set(element, 'data-state', state && state !== 'ok' ? state : null);
  set(element, 'title', state && state !== 'ok' ? state : null);
}

function showFacts(facts) {
  say(at('machine'), facts.machine);
  const open = facts.open ? `Open to the network: whoever reaches ${facts.address} can read this page. ` : '';
  say(at('foot'), `${open}Read-only. ROS domain ${facts.domain}. Press ? for keys.`);
  set(at('foot'), 'data-open', facts.open);
}

function showConnection(isLive, seconds) {
  live = isLive;
  const [symbol, text] = at('live').children;
  set(at('live'), 'data-state', isLive ? 'ok' : 'error');
  setIcon(symbol, isLive ? 'ok' : 'error');
  say(text, isLive ? 'live' : 'lost');
  set(document.documentElement, 'data-lost', !isLive);
  at('banner').hidden = isLive;
  const words = store.facts ? 'What you see is old' : 'Nothing was received yet';
  const next = isLive ? '' : `No connection to the dashboard. ${words}; trying again.`;
  if (next !== lostText) at('banner').textContent = lostText = next;
  set(at('banner'), 'title', isLive ? null : `for ${Math.round(seconds)} s`);
  if (view) showAll();
}

function search() {
  const field = main.querySelector('input[type=search]');
  if (field) field.focus();
  else location.hash = '#/devices';
}

const KEYS = {
  1: () => { location.hash = '#/'; }, 2: () => { location.hash = '#/devices'; },
  3: () => { location.hash = '#/log'; }, 4: () => { location.hash = '#/bridge'; },
  '/': search, t: () => window.toggleTheme(), '?': () => at('keys').showModal(),
  u: () => { location.hash = view.up?.() ?? '#/'; },
  '[': () => step(-1), ']': () => step(1),
};

function step(by) {
  const to = view.step?.(by);
  if (to) location.replace(to);      // one step back leads out of the devices, not through them all
}

addEventListener('keydown', (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || at('keys').open) return;
  if (event.target.matches('input')) {
    if (event.key === 'Escape') event.target.blur();
    return;
  }
  if (Object.hasOwn(KEYS, event.key)) {
    event.preventDefault();
    KEYS[event.key]();
  }
});
addEventListener('hashchange', () => go(false));
at('theme').addEventListener('click', () => window.toggleTheme());
at('skip').addEventListener('click', () => main.focus());
setInterval(() => { if (!document.hidden && live) view.update(store); }, TICK_MS);
go(true);
