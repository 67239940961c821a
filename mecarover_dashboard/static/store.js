// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// What the page knows: rows by section and name, and what follows from them for a bus and a robot.

import {id3, isolate, numberOf} from './format.js';

const HISTORY_S = 320;
const SAMPLE_S = 0.4;
const LOOK_S = 6;                     // so long ROS may need to find who publishes
export const GAP_S = 3.5;             // without a value for so long: a gap
const NOT_KNOWN = 'not known now';    // the banner says why
const AWAY = new Set(['disconnected', 'expected']);
const SECTIONS = ['devices', 'buses', 'bridge', 'timing'];
export const LEVELS = ['ok', 'warn', 'error', 'stale'];
export const WORDS = {ok: 'OK', warn: 'Warning', error: 'Error', stale: 'Silent'};
// What is sent of a device's health, in this order: texts, '' where it is not known.
const VALUES = ['temperature', 'voltage', 'load', 'loadUnit', 'position', 'positionUnit',
  'positionLow', 'positionHigh', 'temperatureHigh', 'voltageLow', 'voltageHigh'];
const namedValues = (texts) =>
  Object.fromEntries(VALUES.map((name, index) => [name, texts[index] ?? '']));
const NOT_KNOWN_VALUES = namedValues([]);
const SEVERITY = {ok: 0, warn: 1, stale: 2, error: 3};

/** The order of two states: an error first, then what is silent. */
export const worstFirst = (a, b) => SEVERITY[b] - SEVERITY[a];
export const worst = (states) => states.reduce((a, b) => worstFirst(a, b) > 0 ? b : a, 'ok');
export const isQuiet = (row) => row?.quiet_since !== undefined;
export const stateOf = (row) => !row || isQuiet(row) ? 'stale' : LEVELS[row.level] ?? 'stale';
export const byUrgency = (a, b) => worstFirst(stateOf(a), stateOf(b)) || a.id - b.id;
/** The state of a device on its card: what its bus has may be trouble of its own. */
export const cardStateOf = (device) =>
  isQuiet(device) ? 'stale' : worst([stateOf(device), device.cause?.[0] ?? 'ok']);
export const isLost = (device) => stateOf(device) === 'error' && AWAY.has(device.state);
export const deviceName = (device) =>
  device.joint ? `${id3(device.id)} ${isolate(device.joint)}` : id3(device.id);

/** What a robot is called; its namespace may be empty. */
export const robotName = (robot) => robot || 'no namespace';

/** Whether a device's status says more than the word of its state; an old one says nothing. */
export const saysMore = (device) => !isQuiet(device) && device.message !== device.state;

/** What is said of a device: the word of its level first, then its state. */
export function wordOf(device) {
  if (isQuiet(device)) return 'no report';
  const state = stateOf(device);
  if (state === 'stale' && device.state === 'connected') return 'not known';
  return state === 'ok' ? device.state : `${WORDS[state]}: ${device.state}`;
}

export class Store {
  devices = new Map();
  buses = new Map();
  bridge = new Map();
  timing = new Map();
  all = [];                  // every bridge and bus, as the server says: robot_parts.py
  isLive = true;             // the server is heard
  #values = new Map();       // by name of the device, where asked for
  facts = null;
  topics = {};
  publishers = {};
  robot = null;              // the robot that is shown; null: all of them
  table = null;              // the device looked at: {name, facts, fields, latency, history}
  #offset = 0;
  #wall = 0;                 // Unix time where the server's clock is 0
  #groups = null;

  /** Seconds on the server's clock, now. */
  now() { return performance.now() / 1000 + this.#offset; }

  /** Unix time of a time on the server's clock. */
  wall(seconds) { return seconds == null ? null : this.#wall + seconds; }

  /** The health of a device, by the names of VALUES. */
  valuesOf(device) { return this.#values.get(device.name) ?? NOT_KNOWN_VALUES; }

  /** Whether ROS may still be looking for publishers. */
  get isNew() { return !this.facts || this.up < LOOK_S; }

  apply(event) {
    this.isLive = true;
    this.#offset = event.now - performance.now() / 1000;
    this.#wall = event.wall - event.now;
    this.#groups = null;
    if (event.facts) {
      for (const section of SECTIONS) this[section].clear();
      this.facts = event.facts;
    }
    for (const name of ['topics', 'publishers', 'malformed', 'refused', 'up', 'history',
      'player']) {
      this[name] = event[name];
    }
    for (const section of SECTIONS) {
      for (const [name, row] of Object.entries(event[section] ?? {})) {
        this.#put(this[section], name, row);
      }
    }
    this.all = event.parts ?? this.all;
    for (const [name, texts] of Object.entries(event.values ?? {})) {
      this.#values.set(name, namedValues(texts));
    }
    if (event.table) this.#take(event.table);
    this.#sample(event.now);
  }

  #put(rows, name, row) {
    if (row === null) {
      rows.delete(name);
      return;
    }
    row.name = name;
    if (row.points) row.points = add(rows.get(name)?.points ?? [], row.points, this.now());
    rows.set(name, row);
  }

  #take(change) {
    if (this.table?.name !== change.name) {
      this.table = {name: change.name, facts: [], fields: [], latency: [], history: new Map()};
    }
    const {table} = this;
    if (change.facts) table.facts = change.facts;
    if (change.fields) {
      table.fields = change.fields.map((field) => ({...named(field), changed: 0}));
    }
    for (const [at, field] of Object.entries(change.some ?? {})) {
      const old = table.fields[at];
      const differs = old.value !== field[1];
      table.fields[at] = {...named(field), changed: differs ? this.now() : old.changed};
    }
    if (change.latency) table.latency = add(table.latency, change.latency, this.now());
  }

  /** Keep what can be plotted of the device looked at, also while it does not change. */
  #sample(now) {
    const {table} = this;
    if (!table || isQuiet(this.devices.get(table.name))) return;
    for (const {key, value, raw, seen} of table.fields) {
      const isOld = seen !== null && now - seen > GAP_S;       // not measured: no point
      if (!isOld) this.#point(key, numberOf(raw || value), now);
      else if (!table.history.has(key)) this.#point(key, numberOf(raw || value), seen);
    }
    for (const [key, value] of table.facts) this.#point(key, numberOf(value), now);
  }

  #point(key, value, now) {
    if (!Number.isFinite(value)) return;
    const {history} = this.table;
    if (!history.has(key)) history.set(key, []);
    const points = history.get(key);
    const last = points.at(-1);
    if (last && last[1] === value && now - last[0] < SAMPLE_S) return;
    points.push([now, value]);
    if (points[0][0] < now - HISTORY_S) points.shift();
  }

  /** Take note that the server is not heard. */
  lose() {
    this.isLive = false;
    this.#groups = null;
  }

  /** Show one robot, by its namespace; null: all of them. */
  show(robot) {
    this.robot = robot;
    this.#groups = null;
  }

  /** The namespaces of all robots, in order. */
  robots() {
    const names = new Set();
    for (const section of SECTIONS) for (const row of this[section].values()) names.add(row.robot);
    return [...names].sort();
  }

  #of(rows) {
    const all = [...rows.values()];
    return this.robot === null ? all : all.filter((row) => row.robot === this.robot);
  }

  /** What the robot shown is called, in files: by its namespace, or else by its machine. */
  get name() { return this.robot || this.robots().join('_') || this.facts.machine; }

  /** The bridge and the buses of the robot shown, the worst first; none is known while the */
  /** server is not heard. */
  parts(robot = this.robot) {
    const some = robot === null ? this.all : this.all.filter((part) => part.robot === robot);
    return some.map((part) => this.isLive ? {...part, state: LEVELS[part.level]}
      : {...part, state: 'stale', is_known: false, mark: 'no connection', key: 'no connection',
        headline: NOT_KNOWN, text: NOT_KNOWN, since: null});
  }

  /** What a part says, or a text of it, with the time since its last report. */
  said({headline, since}, text = headline) {
    return isolate(text) + (since === null ? ''
      : `; last report ${Math.round(this.now() - since)} s ago`);
  }

  /** Buses with their devices: {part, key, label, lost, models, ...}, the worst first. */
  groups() { return this.#groups ??= this.#group(); }

  #group() {
    const groups = this.parts().filter(({bus}) => bus !== null).map((part) => ({
      part, key: `${part.node}/${part.bus}`, node: part.node, robot: part.robot, bus: part.bus,
      state: part.state, row: null, devices: []}));
    const found = new Map(groups.map((group) => [group.key, group]));
    const of = (row) => found.get(`${row.node}/${row.bus}`);
    for (const bus of this.buses.values()) if (of(bus)) of(bus).row = bus;
    for (const device of this.devices.values()) of(device)?.devices.push(device);
    for (const group of groups) sum(group);
    return groups;
  }

  /** The bridge of the robot shown, null where there is none. */
  bridgePart() { return this.parts().find(({bus}) => bus === null) ?? null; }

  /** The rows of the bridge, {link, commands}, and its timing by metric. */
  bridgeParts() {
    const parts = {};
    for (const row of this.#of(this.bridge)) parts[row.part] = row;
    const node = (parts.link ?? parts.commands)?.node;
    return {...parts, timing: this.metrics(node ?? 'vel2d_bridge', '')};
  }

  /** Timing rows of a node about one bus ('' = the node itself), by metric. */
  metrics(node, of) {
    const found = new Map();
    for (const row of this.timing.values()) {
      if (row.node === node && row.of === of) found.set(row.metric, row);
    }
    return found;
  }
}

function sum(group) {
  const {devices, part} = group;
  devices.sort((a, b) => a.id - b.id || (a.name < b.name ? -1 : 1));
  group.label = group.bus || valueOf(group.row, 'Port')?.split('/').pop() || group.node;
  group.lost = devices.filter(isLost);
  for (const device of devices) device.cause = part.is_known ? group.row?.covers[device.id] : null;
  group.models = [...byModel(devices)]
    .map(([model, some]) => ({model, devices: some, part, state: worst(some.map(stateOf))}))
    .sort((a, b) => b.devices.length - a.devices.length || (a.model < b.model ? -1 : 1));
}

/** How many of some devices answer now: '5', or '?' where that is not known. */
export const countOf = (devices, part) =>
  part.is_known ? String(devices.filter(({live}) => live).length) : '?';

function byModel(devices) {
  const found = new Map();
  for (const device of devices) {
    found.set(device.model, [...found.get(device.model) ?? [], device]);
  }
  return found;
}

function add(old, fresh, now) {
  const last = old.at(-1)?.[0] ?? -1;
  const points = [...old, ...fresh.filter((point) => point[0] > last)];
  const from = points.findIndex((point) => point[0] > now - HISTORY_S);
  return from > 0 ? points.slice(from) : points;
}

const named = ([key, value, raw, seen, source]) => ({key, value, raw, seen, source});

/** The value of a key in a row, undefined if there is none. */
export const valueOf = (row, key) => row?.values?.find(([name]) => name === key)?.[1];
