// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// Where the page is: '#/@ROBOT/VIEW/PART/...?filter=...'. Addresses are made and read here only.

let robotPart = '';

/** Name the robot that the links of this page lead to; null where there is only one. */
export function setRobot(robot) {
  robotPart = robot === null ? '' : `@${encodeURIComponent(robot)}/`;
}

/** The address of a view of the robot shown: path('device', NAME). */
export const path = (...parts) => `#/${robotPart}${parts.map(encodeURIComponent).join('/')}`;

/** The address of the overview of a robot, by its namespace. */
export const pathOfRobot = (robot) => `#/@${encodeURIComponent(robot)}/`;

/** What an address says: {robot (null: none is named), view, rest, filters}. */
export function readPlace(hash) {
  const [way, query = ''] = hash.replace(/^#\/?/, '').split('?');
  const filters = new URLSearchParams(query);
  try {
    const [first, ...others] = way.split('/').map(decodeURIComponent);
    if (!first.startsWith('@')) return {robot: null, view: first, rest: others, filters};
    const [view = '', ...rest] = others;
    return {robot: first.slice(1), view, rest, filters};
  } catch {
    return {robot: null, view: '', rest: [], filters};      // no address of ours
  }
}

/** Write filters into the address, so that it can be kept and sent; return its query. Empty ones are left out. */
export function keepFilters(filters) {
  const some = (Array.isArray(filters) ? filters : Object.entries(filters))
    .filter(([, value]) => value);
  const query = new URLSearchParams(some).toString();
  history.replaceState(null, '', location.hash.split('?')[0] + (query ? `?${query}` : ''));
  return query;
}
