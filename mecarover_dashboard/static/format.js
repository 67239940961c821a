// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// How numbers, ages and counts are written.

/** 'Present Position (rad)' -> ['Present Position', 'rad']. */
export function splitUnit(key) {
  const found = /^(.*\S)\s+\(([^()]{1,12})\)$/.exec(key);
  return found ? [found[1], found[2]] : [key, ''];
}

/** A number from the text of a value; NaN for other text. */
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

/** A length of time in seconds, in the unit a person would use: '30 s', '5 min', '8 h'. */
export function span(seconds) {
  if (seconds < 100) return `${figure(seconds, 3)} s`;
  if (seconds < 6000) return `${figure(seconds / 60, 3)} min`;
  return `${figure(seconds / 3600, 3)} h`;
}

/** A number with so many significant digits, never in exponents where a person would not. */
export function figure(value, digits = 4) {
  if (!Number.isFinite(value)) return String(value);
  const size = Math.abs(value);
  if (size < 1e-9) return '0';             // what is left of a sum that is zero
  if (size >= 1e7 || size < 1e-4) return value.toExponential(Math.max(0, digits - 2));
  if (size >= 10 ** (digits - 1)) {
    return Math.round(value).toLocaleString('en').replaceAll(',', '\u202f');
  }
  return String(Number(value.toPrecision(Math.max(1, digits))));
}

const FAR = 1e12;              // beyond this a value cannot be a measurement

/** Whether a number can be drawn: finite, and no 1e308. */
export const isInRange = (value) => Number.isFinite(value) && Math.abs(value) < FAR;

/** Date and time from Unix seconds, in the time zone of this browser: '2026-11-28 14:05:20'. */
export const dateTime = (unix) => new Date(unix * 1000).toLocaleString('sv');

/** As dateTime(), without the date where that is today. */
export function clock(unix, now = Date.now() / 1000) {
  if (unix == null) return '';
  const [day, time] = dateTime(unix).split(' ');
  return dateTime(now).startsWith(day) ? time : `${day} ${time}`;
}

/** The time of Unix seconds in files, in UTC: '2026-11-28T14:05:20.250000+00:00'. */
export function isoTime(unix) {
  const us = Math.round(1e6 * unix);
  return `${new Date(Math.floor(us / 1000)).toISOString().slice(0, -1)}${
    String(us % 1000).padStart(3, '0')}+00:00`;
}

/** The name of a file, of robot, what and when: 'rover1_values_2026-11-28T140520Z.csv'. */
export const fileName = (parts, ending) =>
  `${parts.join('_')}.${ending}`.replace(/[^\w.-]+/g, '_');

/** A time as a part of the name of a file. */
export const stamp = (unix) => `${isoTime(unix).slice(0, 19).replaceAll(':', '')}Z`;

/** How far the time of this browser is from UTC, at a Unix time: '+02:00'. */
export function offset(unix = Date.now() / 1000) {
  const minutes = -new Date(1000 * unix).getTimezoneOffset();
  const two = (value) => String(Math.floor(Math.abs(value))).padStart(2, '0');
  return `${minutes < 0 ? '-' : '+'}${two(minutes / 60)}:${two(minutes % 60)}`;
}

export const zoneName = () => Intl.DateTimeFormat().resolvedOptions().timeZone;

/** The time zone of this browser at a Unix time: 'Europe/Berlin, UTC+02:00'. */
export const zone = (unix) => `${zoneName()}, UTC${offset(unix).replace('-', '\u2212')}`;

/** Text from a topic inside a sentence of ours: its writing direction ends where it ends. */
export function isolate(text) {
  return DIRECTED.test(text) ? `\u2068${text}\u2069` : text;
}

const DIRECTED = /[\u0590-\u08ff\u200e\u200f\u202a-\u202e\u2066-\u2069\ufb1d-\ufeff]/;

/** Figures in a text of a topic: '0.0312345 ' -> '0.03123'; other text stays. */
export function short(text, digits = 4) {
  const value = numberOf(text);
  return Number.isFinite(value) ? figure(value, digits) : text;
}

const MOST_NAMED = 4;

/** 'a, b, c, d and 4 more'; 'all 8' where there are no others. */
export function list(names, all = Infinity) {
  const more = names.length - MOST_NAMED;
  if (more <= 0) return names.join(', ');
  return names.length >= all ? `all ${all}`
    : `${names.slice(0, MOST_NAMED).join(', ')} and ${more} more`;
}

export const plural = (count, word) => `${count} ${word}${count === 1 ? '' : 's'}`;
export const id3 = (id) => String(id).padStart(3, '0');
