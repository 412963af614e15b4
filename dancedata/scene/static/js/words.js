// The lanes of segments: words, moves and events, a lane for each layer.
import { LABEL, lanes, rows, view, xOf } from './axis.js';
import { coloursOf, together } from './dancers.js';
import { plain } from './data.js';
import { css, ratio } from './figure.js';
import { state } from './state.js';

// Layers that are drawn at most.
const MOST = 5;

// Of a group all dancers' segments, of a dancer alone his and those of the whole group.
export function layersOf(clip) {
  const mine = ([, , , member]) => state.dancer === null || member < 0 || member === state.dancer;
  return Object.entries(clip.words || {})
    .slice(0, MOST)
    .map(([name, spans]) => [name, clip.members ? spans.filter(mine) : spans]);
}

export function layOutWords(clip, next) {
  for (const [k] of layersOf(clip).entries()) next(`words${k}`, 14, 3);
}

export function labelWords(label, clip) {
  for (const [k, [name]] of layersOf(clip).entries()) label(plain(name).slice(0, 13), rows[`words${k}`].y + 7);
}

export function drawWords(c, clip) {
  c.textAlign = 'left';
  for (const [k, [, spans]] of layersOf(clip).entries()) {
    const row = rows[`words${k}`];
    for (const [begin, end, text, member] of spans) {
      if (end < view.from || begin > view.to) continue;
      // Dancers who are drawn together share the lane, each in a part of it.
      const share = together() && member >= 0 ? clip.members.length : 1;
      const h = row.h / share;
      const y = row.y + (share > 1 ? member * h : 0);
      const from = Math.max(xOf(begin), LABEL * ratio);
      const wide = Math.max(2 * ratio, xOf(end) - from - ratio);
      c.fillStyle = member >= 0 && clip.members ? coloursOf(clip.members[member])[0] : css.win;
      c.globalAlpha = 0.4;
      c.fillRect(from, y * ratio, wide, h * ratio);
      c.globalAlpha = 1;
      c.fillRect(from, y * ratio, 1.5 * ratio, h * ratio);
      if (wide < 22 * ratio || share > 1) continue;
      c.save();
      c.beginPath();
      c.rect(from, y * ratio, Math.min(wide, lanes.width - from), h * ratio);
      c.clip();
      c.fillStyle = css.ink;
      c.fillText(plain(text), from + 5 * ratio, (y + h / 2) * ratio);
      c.restore();
    }
  }
}

// What is said at a time: the shortest segment of each layer.
export const wordsAt = (clip, t) =>
  layersOf(clip)
    .map(([, spans]) => spans.filter(([begin, end]) => begin <= t + 1e-4 && t < end - 1e-4))
    .filter(here => here.length)
    .map(here => plain(here.reduce((a, b) => (a[1] - a[0] <= b[1] - b[0] ? a : b))[2]));
