// The overview of a long clip, below the lanes: all of it, and the range that they show, which can be dragged.
import { LABEL, lanes, rows, view, zoomTo } from './axis.js';
import { css, ratio } from './figure.js';
import { duration, state } from './state.js';

// Pixels around an end of the range by which it is held.
const NEAR = 7;
// What is dragged: the ends that move, seconds of the press, and the range then.
let held = null;

const width = () => lanes.width / ratio - LABEL;
const mapX = s => LABEL + (s / duration()) * width();
const mapSeconds = x => Math.max(0, Math.min(duration(), ((x - LABEL) / width()) * duration()));

export const inMap = y => !!rows.map && y >= rows.map.y - 1;

// The loudest, or else the fastest, of every two pixels; flags above.
export function drawMap(c, clip) {
  const { y, h } = rows.map;
  const values = clip.wave || (clip.onset || clip.speed)?.values || [];
  const most = clip.wave ? 1 : (clip.onset || clip.speed)?.max || 1;
  const each = (2 * values.length) / width();
  c.fillStyle = css.wave;
  for (let k = 0; k * 2 < width(); k++) {
    let high = 0;
    for (let i = Math.floor(k * each); i < (k + 1) * each && i < values.length; i++) high = Math.max(high, values[i]);
    const tall = Math.max(1, (high / most) * (h - 4));
    c.fillRect((LABEL + 2 * k) * ratio, (y + h - tall) * ratio, 2 * ratio, tall * ratio);
  }
  c.fillStyle = css.flag;
  for (const t of clip.flagTimes || []) c.fillRect(mapX(t) * ratio, y * ratio, ratio, 3 * ratio);
}

export function drawRange(c) {
  const { y, h } = rows.map;
  const [from, to, now] = [view.from, view.to, state.t].map(s => mapX(s) * ratio);
  c.fillStyle = css.panel;
  c.globalAlpha = 0.65;
  c.fillRect(LABEL * ratio, y * ratio, from - LABEL * ratio, h * ratio);
  c.fillRect(to, y * ratio, lanes.width - to, h * ratio);
  c.globalAlpha = 1;
  c.strokeStyle = c.fillStyle = css.accent;
  c.lineWidth = ratio;
  c.strokeRect(from, y * ratio, to - from, h * ratio);
  for (const x of [from, to - 3 * ratio]) c.fillRect(x, y * ratio, 3 * ratio, h * ratio);
  c.fillStyle = css.ink;
  c.fillRect(now - ratio / 2, y * ratio, ratio, h * ratio);
}

// Holds an end, or the range; a press beside it brings it there. Where all is shown, a new range begins.
export function grabMap(x) {
  const at = mapSeconds(x);
  const ends = ['from', 'to'].filter(end => Math.abs(mapX(view[end]) - x) < NEAR);
  const whole = view.to - view.from > duration() - 1e-3;
  const half = (view.to - view.from) / 2;
  if (!ends.length && !whole && (at < view.from || at > view.to)) zoomTo(at - half, at + half);
  held = { at, end: ends[0] || (whole ? 'new' : ''), from: view.from, to: view.to };
}

// Whether the range is held.
export function dragMap(x) {
  if (!held) return false;
  const at = mapSeconds(x);
  const { end, from, to } = held;
  if (end === 'from') zoomTo(Math.min(at, to - 0.5), to);
  else if (end === 'to') zoomTo(from, Math.max(at, from + 0.5));
  else if (end) zoomTo(Math.min(at, held.at), Math.max(at, held.at));
  else zoomTo(from + at - held.at, to + at - held.at);
  return true;
}

export function dropMap() {
  held = null;
}
