// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// The devices of a bus, a card each: of a servo its joint, where in its range it is, load,
// temperature, voltage; of a board its model and how it answers. A bar needs a scale: what the
// device itself says, or else the usual one.

import {each, h, icon, say, sayWords, set, showState} from './dom.js';
import {clock, id3, numberOf, short} from './format.js';
import {spelt} from './finding.js';
import {path} from './place.js';
import {cardStateOf, isQuiet, saysMore, stateOf, wordOf} from './store.js';
import {positionText} from './units.js';

const FEW = 8;                 // as many as a small display has room for
const SOME = 30;
const COLD = 20;               // °C, where the bar of the temperature begins
const HOT = 80;

/** How much room a bus needs: 'few', 'some', or 'many', which are cells without values. */
export const sizeOf = (count) => count <= FEW ? 'few' : count <= SOME ? 'some' : 'many';

/** A value on a scale: {name, text, from, to}, shares of the bar; no bar where there is no scale. */
const MEASURES = {
  position: ({position, positionUnit: unit, positionLow: low, positionHigh: high}) => {
    const [first, last] = numberOf(low) < numberOf(high) ? [low, high]
      : unit === 'rad' && Math.abs(position) <= Math.PI ? [-Math.PI, Math.PI] : [NaN, NaN];
    const at = share(position, first, last);
    return {name: 'Position', text: positionText(position, unit), from: at - 0.02, to: at + 0.02};
  },
  load: ({load, loadUnit: unit}, most) => {
    const at = share(load, -most, most);
    const text = unit === 'A' ? Number(load).toFixed(2).replace(/^-(0\.00)$/, '$1')
      : short(load, 2);
    return {name: unit === 'A' ? 'Current' : 'Load', text: `${text} ${unit}`,
      from: Math.min(at, 0.5), to: Math.max(at, 0.5)};
  },
  temperature: ({temperature, temperatureHigh: limit}) => ({name: 'Temperature',
    text: `${short(temperature, 3)} \u00b0C`, from: 0,
    to: share(temperature, COLD, Number(limit) || HOT)}),
  voltage: ({voltage, voltageLow: low, voltageHigh: high}) => ({name: 'Voltage',
    text: `${short(voltage, 3)} V`, from: 0,
    to: numberOf(low) < numberOf(high) ? share(voltage, low, high) : 0}),
};
const NAMES = Object.keys(MEASURES);
const share = (value, low, high) => Math.min(1, Math.max(0, (value - low) / (high - low)));

/** Cards; `texts`: what cards show in place of the message of a device, '' for nothing. */
export function showServos(grid, devices, store, texts) {
  each(grid, devices, (device) => device.name, makeServo,
    (item, device) => showServo(item, device, store, texts.get(device)));
}

const makeServo = (device) => h('li', {}, h('a', {class: 'servo',
  href: path('device', device.name)},
h('p', {class: 'servo-head'}, icon('ok'), h('b', {}), h('span')), h('p', {class: 'servo-text'}),
h('p', {class: 'servo-about'}),
...NAMES.map((name) => h('p', {class: `measure ${name}`}, h('span'), h('span'),
  h('i', {}, h('i'))))));

/** How a device answers: '0.11 ms'; what it misses first, where it misses any. */
export const answersOf = ({loss, latency}) => [loss && loss !== '0' && `loss ${short(loss, 2)} %`,
  latency && `${short(latency, 3)} ms`].filter(Boolean).join(' \u00b7 ');

function showServo(item, device, store, instead) {
  const values = store.valuesOf(device);
  const [head, text, about, ...lines] = item.firstChild.children;
  const state = cardStateOf(device);
  set(item.firstChild, 'data-state', state);
  showState(head, state);
  say(head.children[1], id3(device.id));
  sayInParts(head.children[2], device.joint || device.model);
  const isSick = state !== 'ok';
  text.hidden = !isSick || instead === '';
  const word = isQuiet(device)
    ? `${wordOf(device)} since ${clock(store.wall(device.quiet_since))}`
    : stateOf(device) === 'ok' && isSick ? spelt(device.cause[1]) : wordOf(device);
  if (isSick) sayWords(text, instead ?? (saysMore(device) ? device.message : word));
  set(item, 'data-sick', isSick);
  const isKnown = (name) => Number.isFinite(numberOf(values[name]));
  about.hidden = isKnown('position') || !device.live;
  set(item, 'data-board', about.hidden ? null : '');
  if (!about.hidden) {
    say(about, [device.joint && device.model, answersOf(device)].filter(Boolean).join(' \u00b7 '));
  }
  const most = item.most = values.loadUnit === '%' ? 100
    : Math.max(item.most ?? 1, Math.abs(numberOf(values.load)) || 0);
  NAMES.forEach((name, at) => {
    lines[at].hidden = !isKnown(name);
    if (isKnown(name)) showMeasure(lines[at], MEASURES[name](values, most));
  });
}

/** A name that may go on in the next line after each of its words. */
function sayInParts(element, name) {
  if (element.textContent === name) return;
  element.replaceChildren(...name.split(/(?<=[_ -])/).flatMap((part) => [part, h('wbr')]));
}

function showMeasure(line, {name, text, from, to}) {
  const [label, words, bar] = line.children;
  say(label, name);
  say(words, text);
  bar.hidden = !(to > 0);
  bar.firstChild.style.left = `${100 * from}%`;
  bar.firstChild.style.width = `${100 * (to - from)}%`;
}
