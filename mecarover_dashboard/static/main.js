// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// The frame around the views: which one is shown, what the header says, the lost connection.

import {BridgeView} from './bridge.js';
import {DeviceView} from './device.js';
import {Devices} from './devices.js';
import {say, sayWords, set, showState} from './dom.js';
import {FindingView} from './finding.js';
import {dateTime, figure, plural, zone} from './format.js';
import {HistoryView} from './history.js';
import {listenToKeys} from './keys.js';
import {LogView} from './log.js';
import {Overview} from './overview.js';
import {path, readPlace, setRobot} from './place.js';
import {Player} from './player.js';
import {Robots} from './robots.js';
import {SignalsView} from './signals.js';
import {robotName, Store, worst} from './store.js';
import {Stream} from './stream.js';
import {shownIn, toggleAngles} from './units.js';

const VIEWS = {'': Overview, devices: Devices, device: DeviceView, log: LogView,
  bridge: BridgeView, history: HistoryView, robots: Robots,
  signals: SignalsView, finding: FindingView};
const TAB = {'': 'overview', device: 'devices', finding: 'log', robots: ''};
const TICK_MS = 1000;          // ages go on while nothing is pushed

const store = new Store();
const at = (id) => document.getElementById(id);
const main = at('main');
const player = new Player(at('player'));
let view = null;
let left = null;               // the view Signals that was shown last: {key, view}
let shown = '';                // the view on the page, with its robot
let live = true;
let lostText = '';

const stream = new Stream(take, showConnection);

function take(event) {
  const page = store.facts?.page;
  store.apply(event);
  if (page && event.facts && event.facts.page !== page) location.reload();
  if (event.facts) showFacts(event.facts);
  if (wanted().key !== shown) go(true);            // a second robot has come
  showAll();
}

/** What the address asks for, as far as it can be shown. */
function wanted() {
  const place = readPlace(location.hash);
  const robots = store.robots();
  const robot = place.robot ?? (robots.length === 1 ? robots[0] : null);
  let name = Object.hasOwn(VIEWS, place.view) && place.view !== 'robots' ? place.view : '';
  if (['device', 'finding'].includes(name) && !place.rest[0]) name = '';
  if (robot === null && robots.length > 1) name = 'robots';
  return {...place, name, robot, isOne: robots.length < 2 && place.robot === null,
    key: `${name}@${robots.length > 1 || place.robot !== null ? robot : ''}`};
}

function go(isFirst) {
  const {name, robot, rest, filters, isOne, key} = wanted();
  shown = key;
  showAngles();
  view?.close?.();
  setRobot(isOne ? null : robot);
  store.show(isOne ? null : robot);
  view = name === 'signals' ? signalsView(key, filters) : new VIEWS[name](rest, filters);
  stream.watch(view.watch ?? '', view.wantsValues ?? false);
  main.replaceChildren(view.element);
  document.body.dataset.view = name || 'overview';
  scrollTo(0, 0);
  if (!isFirst) (main.querySelector('h1') ?? main).focus({preventScroll: true});
  showAll();
}

/** As it was left, with its choice and a pause; not where the address asks for something else. */
function signalsView(key, filters) {
  if (left?.key === key && ['', left.view.query].includes(filters.toString())) {
    left.view.resume();
  } else {
    left?.view.plots.close();
    left = {key, view: new SignalsView([], filters)};
  }
  return left.view;
}

function showAngles() {
  const unit = shownIn('rad')[0] === 'rad' ? 'rad' : 'deg';
  say(at('angles'), unit);
  set(at('angles'), 'aria-label', `Angles in ${unit}`);
}

/** Most views are made for one unit: make them again. */
function changeAngles() {
  toggleAngles();
  go(true);
}

/** The links to the views, and the name of the robot. */
function showTabs() {
  const {name, robot} = wanted();
  const tab = TAB[name] ?? name;
  for (const link of document.querySelectorAll('.views a')) {
    const to = link.dataset.view;
    set(link, 'href', path(...to === 'overview' ? [] : [to]));
    set(link, 'aria-current', to === tab ? 'page' : null);
    link.hidden = name === 'robots' || (to === 'bridge' && Boolean(store.facts?.source))
      || (to === 'history' && Boolean(store.player));
  }
  say(at('robot'), robot || (robot === null || store.robots().length < 2 ? '' : robotName(robot)));
}

function showAll() {
  showTabs();
  if (!store.facts) return;
  view.update(store);
  stream.watch(view.watch ?? '', view.wantsValues ?? false);
  player.update(store.player ?? null);
  const parts = store.parts();
  const of = (isBridge) => parts.filter(({bus}) => (bus === null) === isBridge)
    .map(({state}) => state);
  pip('overview', of(false).length ? worst(of(false)) : null);
  pip('bridge', of(true).length ? worst(of(true)) : null);
  const isLive = live && parts.every(({is_known: isKnown}) => isKnown);
  const words = store.player ? 'recording' : isLive ? 'live' : 'not live';
  if (live) showLive(isLive ? 'ok' : 'stale', words);
  const wrong = parts.filter(({state}) => state !== 'ok');
  const headline = headlineOf(wrong);
  showTitle(wrong, headline);
  showHeadline(wrong, headline);
  showRefused();
  showPrinted();
  at('history').hidden = !store.history;
  say(at('history'), store.history ? `History: ${store.history}` : '');
  announce(wrong, parts.length > 0);
}

const MARKS = {error: '\u2716', stale: '?', warn: '\u25b2'};      // as the icons on the page
const withRobot = ({robot}, text) => store.robot === null && store.robots().length > 1
  ? `${robotName(robot)}: ${text}` : text;

/** '2 problems: 007 silent; 003 too hot'; one alone is not counted. */
function headlineOf(wrong) {
  const count = wrong.reduce((sum, part) => sum + part.number, 0);
  const marks = wrong.map((part) => withRobot(part, part.mark)).join('; ');
  return count > 1 ? `${count} problems: ${marks}` : marks;
}

/** Each view but the overview, whose bars say it; without connection the banner does. */
function showHeadline(wrong, text) {
  const headline = at('headline');
  headline.hidden = !wrong.length || !live || document.body.dataset.view === 'overview';
  if (headline.hidden) return;
  set(headline, 'href', path());
  showState(headline, wrong[0].state);
  set(headline, 'data-known', String(wrong[0].is_known));
  sayWords(headline.lastChild, text);
}

/** The tab says what is wrong, too: somebody may look at another one. */
function showTitle(wrong, headline) {
  document.title = [
    ...!live ? ['? no connection'] : wrong.length
      ? [`${MARKS[wrong[0].state]} ${headline}`] : [],
    view.title, wanted().robot || store.facts.machine].join(' \u00b7 ');
}

/** Tell a screen reader what is wrong, when that changes; a number that changes is no change. */
function announce(wrong, isAny) {
  const key = wrong.map((part) => part.key).join();
  if (key !== announce.last && announce.last !== undefined) {
    sayWords(at('said'), wrong.map((part) => withRobot(part, `${part.name}: ${part.text}`)).join('. ')
      || (isAny ? 'No problem now' : ''));
  }
  announce.last = key;
}

/** What is printed carries its date. */
function showPrinted() {
  say(at('printed'),
    `${dateTime(store.wall(store.now()))} (${zone()}), ${store.facts.machine}`);
}

function pip(name, state) {
  const element = document.querySelector(`[data-pip=${name}]`);
  set(element, 'data-state', state && state !== 'ok' ? state : null);
  set(element, 'title', state && state !== 'ok' ? state : null);
}

function showFacts(facts) {
  say(at('machine'), facts.machine);
  set(at('brand'), 'aria-label', facts.machine);         // on a small screen only its sign is shown
  const open = facts.open
    ? `Open to the network: everybody who can reach ${facts.address} can read this page. ` : '';
  const from = facts.source ? `Listens to ${facts.source}` : `ROS domain ${facts.domain}`;
  say(at('foot-text'), `${open}Read-only. ${from}. Press ? for keys.`);
  set(at('foot'), 'data-open', facts.open);
}

/** Say at the end of the page what could not be shown. */
function showRefused() {
  const {refused, malformed} = store;
  at('refused').hidden = !refused && !malformed;
  const lines = [refused && `${plural(refused, 'status').replace('statuss', 'statuses')} `
    + 'left out: too many or too long for this page.',
  malformed && `${plural(malformed, 'message')} could not be read.`].filter(Boolean);
  say(at('refused'), lines.join(' ').replace(/^\d+/, (text) => figure(Number(text), 9)));
}

function showConnection(isLive, seconds, why) {
  live = isLive;
  const isFirst = !store.facts && !why;
  if (!isLive) {
    store.lose();
    showLive(isFirst ? 'stale' : 'error', 'lost');
  }
  set(document.documentElement, 'data-lost', !isLive);
  at('banner').hidden = isLive;
  const words = store.facts ? 'These values are old' : 'No data received yet';
  const next = isLive ? ''
    : `${why || 'No connection to the dashboard.'} ${words}; trying again.`;
  if (next !== lostText) at('banner').textContent = lostText = next;
  set(at('banner'), 'title', isLive ? null : `for ${Math.round(seconds)} s`);
  if (view) showAll();
}

function showLive(state, words) {
  showState(at('live'), state);
  say(at('live').lastChild, words);
}

listenToKeys({step: (by) => view.step?.(by), up: () => view.up?.(),
  search: () => main.querySelector('input[type=search]')}, changeAngles);
addEventListener('hashchange', () => go(false));
at('angles').addEventListener('click', changeAngles);
at('theme').addEventListener('click', () => window.toggleTheme());
at('skip').addEventListener('click', () => main.focus());
setInterval(() => { if (!document.hidden && live) showAll(); }, TICK_MS);
go(true);
