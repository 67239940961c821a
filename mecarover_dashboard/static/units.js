// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// Angles in degrees or radians: chosen once, kept by this browser. Topics and files have radians.

import {figure, numberOf} from './format.js';

const STORED = 'angles';
const DECIMALS = new Map([['rad', 2], ['\u00b0', 1]]);        // however many turns
const DECIMALS_OF_OTHERS = 3;
let isInDegrees = false;
try {
  isInDegrees = localStorage.getItem(STORED) === 'degrees';
} catch { /* no storage: as on the first visit */ }

/** Show angles in the other unit. */
export function toggleAngles() {
  isInDegrees = !isInDegrees;
  try {
    localStorage.setItem(STORED, isInDegrees ? 'degrees' : 'radians');
  } catch { /* for this visit only */ }
}

/** [unit, factor]: how values that are reported in a unit are shown. */
export const shownIn = (unit) => isInDegrees && /^rad\b/.test(unit)
  ? [unit.replace('rad', '\u00b0'), 180 / Math.PI] : [unit, 1];

export const withUnit = (text, unit) => text + (unit && unit !== '\u00b0' ? ` ${unit}` : unit);

/** The position of a servo, from the text that is reported; '' where that is no number. */
export function positionText(value, reported) {
  const [unit, factor] = shownIn(reported);
  const number = factor * numberOf(value);
  if (!Number.isFinite(number)) return '';
  const text = number.toFixed(DECIMALS.get(unit) ?? DECIMALS_OF_OTHERS);
  return withUnit(Number(text) === 0 ? text.replace('-', '') : text, unit);
}

/** A number in a unit as it is shown; an angle keeps its decimals over many turns. */
export function measured(value, unit) {
  const size = Math.abs(value);
  const isLarge = DECIMALS.has(unit) && size >= 100 && size < 1e7;
  return figure(value, isLarge ? 1 + Math.floor(Math.log10(size)) + DECIMALS.get(unit) : 4);
}
