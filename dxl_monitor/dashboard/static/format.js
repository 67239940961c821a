// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// How numbers, ages and counts are written.

/** 'Present Position (rad)' -> ['Present Position', 'rad']. */
export function splitUnit(key) {
  const found = /^(.*\S)\s+\(([^()]{1,12})\)$/.exec(key);
  return found ? [found[1], found[2]] : [key, ''];
}

/** A number from the text of a value; NaN for whatever is none. */
export function numberOf(text) {
  return typeof text === 'string' && text.trim() !== '' && text.length < 40 ? Number(text) : NaN;
}

/** An age in seconds, short. */
export function age(seconds) {
  if (!(seconds >= 0)) return '';
  if (seconds < 1) return 'now';
  if (seconds < 100) return `${Math.floor(seconds)} s`;
  if (seconds < 6000) return `${Math.floor(seconds / 60)} min`;
  return seconds < 360000 ? `${Math.floor(seconds / 3600)} h` : `${Math.floor(seconds / 86400)} d`;
}

/** A number with so many significant digits, never in exponents where a person would not. */
export function figure(value, digits = 4) {
  if (!Number.isFinite(value)) return String(value);
  if (value === 0) return '0';
  const size = Math.abs(value);
  if (size >= 1e7 || size < 1e-4) return value.toExponential(digits - 2);
  if (size >= 10 ** (digits - 1)) return Math.round(value).toLocaleString('en').replaceAll(',', '\u202f');
  return String(Number(value.toPrecision(digits)));
}

/** Figures in a text of a topic: '0.0312345 ' -> '0.03123'; other text stays. */
export function short(text, digits = 4) {
  const value = numberOf(text);
  return Number.isFinite(value) ? figure(value, digits) : text;
}

/** 'a, b, c and 4 more'. */
export function list(names, most = 4) {
  if (names.length <= most) return names.join(', ');
  return `${names.slice(0, most).join(', ')} and ${names.length - most} more`;
}

export const plural = (count, word) => `${count} ${word}${count === 1 ? '' : 's'}`;
export const id3 = (id) => String(id).padStart(3, '0');
export const path = (...parts) => `#/${parts.map(encodeURIComponent).join('/')}`;
