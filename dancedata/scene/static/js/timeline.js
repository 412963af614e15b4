// The lanes of the time axis: music, speed, contacts, windows and flags, one below the other. Heights in CSS pixels.
import {
  contactSpans,
  drawCurve,
  drawSpans,
  drawSpeed,
  LABEL,
  lanes,
  moveBy,
  rows,
  setLabel,
  view,
  xOf,
  zoomAround,
  zoomTo,
} from './axis.js';
import { seek, setLoop } from './clock.js';
import { together } from './dancers.js';
import { make, on, root } from './data.js';
import { css, fontOf, ratio, triangle } from './figure.js';
import { marksOf, signOf } from './marks.js';
import { dragMap, drawMap, drawRange, dropMap, grabMap, inMap } from './overview.js';
import { drawGroupLanes, drawPairs, labelGroup, layOutGroup, numbersWidth } from './pairs.js';
import { duration, loopSeconds, state } from './state.js';
import { drawWords, labelWords, layOutWords } from './words.js';

const ink = lanes.getContext('2d');
let base = null;
// The time that was drawn last.
let seen = 0;

// A key motion this near to a beat hits it; one this near is early or late, milliseconds.
const HIT_MS = 60;
const NEAR_MS = 250;

export function hitsOf(offsets) {
  const hits = offsets.filter(late => Math.abs(late) <= HIT_MS);
  const mean = hits.length ? Math.round(hits.reduce((a, b) => a + b, 0) / hits.length) : 0;
  const how = mean ? `, ${Math.abs(mean)} ms ${mean > 0 ? 'late' : 'early'}` : '';
  return `${hits.length} of ${offsets.length} beats hit${how}`;
}

// What the lanes hold before the first clip is there.
const NO_CLIP = { onset: 1, speed: 1, figure: { feet: [0, 0, 0, 0] }, windows: [], flags: [], beats: [] };

export function layOut(found) {
  const clip = found || NO_CLIP;
  const many = together()?.length > 6;
  const low = innerHeight <= (together() ? 900 : 719);
  root.classList.toggle('low', low);
  const numbers = numbersWidth();
  root.classList.toggle('tabled', !!numbers);
  setLabel(74 + numbers);
  let y = 20;
  const next = (name, height, gap) => {
    rows[name] = { y, h: height };
    y += height + (low ? Math.min(gap, many ? 1 : 3) : gap);
  };
  for (const name of Object.keys(rows)) delete rows[name];
  next('music', clip.wave || clip.onset ? (low ? (many ? 26 : 34) : together() ? 44 : 58) : 18, 4);
  if (together()) layOutGroup(clip, next, low);
  else next('speed', clip.speed ? (low ? 28 : 40) : 14, 6);
  if (state.other?.distance) next('distance', 30, 6);
  if (!together()) {
    rows.contact = { y, h: low ? 11 : 13 };
    y += (clip.figure ? clip.figure.feet.length : 1) * rows.contact.h + 4;
  }
  if (found) layOutWords(clip, next);
  next('windows', 8, 7);
  next('flags', 15, 3);
  if (duration() >= 60) next('map', 18, 3);
  lanes.style.height = `${y}px`;
}

const secondsAt = e => view.from + ((e.offsetX - LABEL) / (lanes.clientWidth - LABEL)) * (view.to - view.from);

export function drawLanes() {
  if (!lanes.width) return; // not shown in a low page inside another one
  const clip = state.clip;
  const span = view.to - view.from;
  if (state.t !== seen && span < duration() && (state.t > view.to || state.t < view.from))
    zoomTo(state.t - 0.05 * span, state.t + 0.95 * span);
  seen = state.t;
  const key = [
    clip.number,
    clip.field,
    !!clip.wave,
    lanes.width,
    lanes.height,
    view.from,
    view.to,
    css.bg,
    state.other?.name,
    state.dancer,
  ].join(' ');
  if (!base || base.key !== key) {
    const copy = make('canvas');
    copy.width = lanes.width;
    copy.height = lanes.height;
    drawBase(copy.getContext('2d'), clip);
    base = { key, copy };
  }
  ink.clearRect(0, 0, lanes.width, lanes.height);
  ink.drawImage(base.copy, 0, 0);
  ink.save();
  ink.beginPath();
  ink.rect(LABEL * ratio - 6 * ratio, 0, lanes.width, rows.map ? (rows.map.y - 2) * ratio : lanes.height);
  ink.clip();
  const loop = loopSeconds();
  const top = 16 * ratio;
  if (loop) {
    ink.fillStyle = css.accent;
    ink.globalAlpha = 0.16;
    ink.fillRect(xOf(loop[0]), top, xOf(loop[1]) - xOf(loop[0]), lanes.height);
    ink.globalAlpha = 1;
    for (const s of loop) ink.fillRect(xOf(s) - ratio, top, 2 * ratio, lanes.height);
  }
  for (const [start, end, colour] of [
    loop && [...loop, css.accent],
    state.hovered && [state.hovered[0] / clip.fps, (state.hovered[0] + state.hovered[1]) / clip.fps, css.ink],
  ].filter(Boolean)) {
    ink.fillStyle = colour;
    ink.fillRect(xOf(start), (rows.windows.y + 2) * ratio, xOf(end) - xOf(start), 4 * ratio);
  }
  ink.textAlign = 'center';
  ink.textBaseline = 'middle';
  ink.font = fontOf(12);
  ink.fillStyle = css.accent;
  for (const mark of marksOf(state.item)) ink.fillText(signOf(mark), xOf(mark.at), (rows.flags.y + 7) * ratio);
  const x = xOf(state.t);
  ink.fillStyle = css.ink;
  // Below the digits.
  ink.fillRect(x - ratio * 0.75, 14 * ratio, 1.5 * ratio, lanes.height);
  ink.beginPath();
  ink.moveTo(x - 5 * ratio, 13 * ratio);
  ink.lineTo(x + 5 * ratio, 13 * ratio);
  ink.lineTo(x, 20 * ratio);
  ink.fill();
  ink.restore();
  if (rows.map) drawRange(ink);
  lanes.ariaValueMax = duration().toFixed(2);
  lanes.ariaValueNow = state.t.toFixed(2);
  lanes.ariaValueText = `${state.t.toFixed(2)} seconds, frame ${state.drawn}`;
}

function drawBase(c, clip) {
  c.textBaseline = 'middle';
  c.font = fontOf(rows.dancer0?.h < 12 ? 10 : 11);
  drawAxis(c);
  const label = (text, y, colour = css.dim, x = 0, most) => {
    c.fillStyle = colour;
    c.textAlign = 'left';
    c.fillText(text, x * ratio, y * ratio, most && most * ratio);
  };
  c.save();
  labelLanes(label, clip);
  c.beginPath();
  c.rect(LABEL * ratio - 5 * ratio, 0, lanes.width, lanes.height);
  c.clip();
  drawTrim(c, clip);
  drawMusic(c, clip);
  if (together()) {
    drawGroupLanes(c);
    drawPairs(c, clip);
  }
  if (clip.speed) drawSpeed(c, clip, rows.speed, clip.speed.max, css.mid, 4);
  if (rows.distance)
    drawCurve(
      c,
      { ...state.other.distance, max: Math.max(1, state.other.distance.max) },
      rows.distance,
      css.other,
      1.6,
    );
  if (clip.figure && !together()) drawFeet(c, clip.figure);
  drawWords(c, clip);
  drawWindows(c, clip);
  drawFlags(c, clip);
  if (rows.map) drawMap(c, clip);
  c.restore();
}

function labelLanes(label, clip) {
  const mid = name => rows[name].y + rows[name].h / 2;
  label(clip.wave ? 'music' : clip.onset ? 'onset' : 'no music', mid('music'));
  if (together()) labelGroup(label, clip);
  else if (clip.speed) {
    label('speed', rows.speed.y + rows.speed.h * 0.3 - 1);
    label('key motion ◆', rows.speed.y + rows.speed.h * 0.8 - 2);
  } else label('no speed', mid('speed'));
  const top = rows.distance && Math.max(1, state.other.distance.max);
  if (rows.distance) {
    label('distance', rows.distance.y + 8);
    label(`to ${state.other.distance.max < 10 ? top.toFixed(1) : top.toFixed(0)} mm`, rows.distance.y + 22);
  }
  const feet = clip.figure ? clip.figure.feet.map(j => clip.figure.joints[j]) : ['no contacts'];
  for (const [k, name] of together() ? [] : feet.entries())
    label(shortName(name), rows.contact.y + (orderOf(k) + 0.5) * rows.contact.h - 1);
  labelWords(label, clip);
  label('windows', mid('windows'));
  label('flags', mid('flags'));
  if (rows.map) label('all', mid('map'));
}

const shortName = name =>
  name
    .replace(/^left_?/i, 'L ')
    .replace(/^right_?/i, 'R ')
    .replace(/_/g, ' ')
    .slice(0, 12);

// Left ankle, right ankle, left toe, right toe: both joints of a foot below each other.
const orderOf = k =>
  state.clip.figure &&
  state.clip.figure.sides[state.clip.figure.feet[0]] !== state.clip.figure.sides[state.clip.figure.feet[1]]
    ? [0, 2, 1, 3][k]
    : k;

// Triangles; a strip of how many there are where they would lie over each other.
function drawFlags(c, clip) {
  const { y, h } = rows.flags;
  const times = clip.flags.map(f => f[0]).filter(t => t !== null && t >= view.from && t <= view.to);
  const counts = new Map();
  for (const t of times) {
    const place = Math.floor((xOf(t) - LABEL * ratio) / (6 * ratio));
    counts.set(place, (counts.get(place) || 0) + 1);
  }
  if (counts.size < (0.3 * (lanes.width / ratio - LABEL)) / 6) {
    for (const t of times) triangle(c, xOf(t), (y + 7) * ratio, 5 * ratio, css.flag, null);
    return;
  }
  const most = Math.max(...counts.values());
  c.fillStyle = css.flag;
  for (const [place, count] of counts) {
    c.globalAlpha = 0.15 + (0.85 * count) / most;
    c.fillRect((LABEL + 6 * place) * ratio, y * ratio, 6 * ratio, (h - 3) * ratio);
  }
  c.globalAlpha = 1;
}

const clockOf = (s, step) => {
  const digits = step < 1 ? 1 : 0;
  if (duration() < 60) return s.toFixed(digits);
  const rest = (s - 60 * Math.floor(s / 60 + 1e-9)).toFixed(digits);
  return `${Math.floor(s / 60 + 1e-9)}:${rest.padStart(digits ? 4 : 2, '0')}`;
};

function drawAxis(c) {
  const span = view.to - view.from;
  const most = Math.min(16, (lanes.width / ratio - LABEL) / (duration() < 60 ? 34 : 46));
  const step = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 30, 60, 120, 300].find(s => span / s <= most) || 600;
  c.fillStyle = css.dim;
  for (let k = Math.ceil(view.from / step - 1e-9); k * step <= view.to + 1e-9; k++) {
    const s = k * step;
    const x = xOf(s);
    c.textAlign = x > lanes.width - 14 * ratio ? 'right' : 'center';
    c.fillText(clockOf(s, step), x, 7 * ratio);
    c.fillRect(x, 14 * ratio, ratio, 3 * ratio);
  }
}

function drawTrim(c, clip) {
  if (!(clip.trim > view.from)) return;
  const y = 18 * ratio;
  const h = lanes.height - y;
  const end = xOf(Math.min(clip.trim, view.to));
  c.save();
  c.beginPath();
  c.rect(xOf(view.from), y, end - xOf(view.from), h);
  c.clip();
  c.strokeStyle = css.win;
  c.lineWidth = ratio;
  c.globalAlpha = 0.55;
  for (let x = xOf(view.from) - h; x < end; x += 9 * ratio) {
    c.beginPath();
    c.moveTo(x, y + h);
    c.lineTo(x + h, y);
    c.stroke();
  }
  c.restore();
}

function drawMusic(c, clip) {
  const { y, h } = rows.music;
  const w = lanes.width;
  if (clip.wave) {
    c.fillStyle = css.wave;
    const n = clip.wave.length;
    const each = clip.sound.duration / n;
    const wide = Math.max(ratio, xOf(each) - xOf(0));
    for (let i = Math.max(0, Math.floor(view.from / each)); i < n && i * each <= view.to; i++) {
      const half = (clip.wave[i] * h * ratio) / 2;
      c.fillRect(xOf(i * each), (y + h / 2) * ratio - half, wide, 2 * half + ratio);
    }
  }
  if (clip.onset && !(clip.wave && view.to - view.from > 180)) {
    c.globalAlpha = clip.wave ? 0.75 : 1;
    drawCurve(c, clip.onset, rows.music, clip.wave ? css.ink : css.wave, clip.wave ? 1 : 1.4);
    c.globalAlpha = 1;
  }
  const last = together() ? `dancer${clip.members.length - 1}` : 'speed';
  const low = clip.speed || together() ? rows[last].y + rows[last].h : y + h;
  // Beats that nearly touch keep their points; lines would hide the music, and points below 3 px as well.
  const n = clip.beats.length;
  const each = n > 1 ? (xOf(clip.beats[n - 1]) - xOf(clip.beats[0])) / (n - 1) / ratio : 9;
  if (each < 3) return;
  const dense = each < 7;
  for (const [k, beat] of clip.beats.entries()) {
    const x = xOf(beat);
    if (x < 0 || x > w) continue;
    const late = together() ? undefined : clip.offsets?.[k];
    c.fillStyle = Math.abs(late) <= HIT_MS ? css.contact : css.accent;
    c.globalAlpha = dense ? 0.2 : 0.55;
    const bold = clip.downbeats?.includes(k) ? 2.4 : 1;
    c.fillRect(x - (bold * ratio) / 2, y * ratio, bold * ratio, (low - y) * ratio);
    c.globalAlpha = 1;
    c.beginPath();
    c.arc(x, (y + h) * ratio, (Math.abs(late) <= HIT_MS ? 3 : 2.3) * ratio, 0, 7);
    c.fill();
    // A beat whose key motion came too early or too late has it on that side.
    if (Math.abs(late) > HIT_MS && Math.abs(late) <= NEAR_MS && !dense) {
      const side = Math.sign(late) * 4 * ratio;
      c.fillRect(Math.min(x, x + 2 * side), (y + h) * ratio - ratio / 2, Math.abs(2 * side), 1.4 * ratio);
    }
  }
}

function drawFeet(c, figure) {
  figure.feet.forEach((joint, bit) => {
    const side = figure.sides[joint];
    c.fillStyle = side > 1 ? striped(c) : [css.mid, css.left][side];
    const { y, h } = rows.contact;
    drawSpans(c, contactSpans(figure, 1 << bit), figure.rate, y + orderOf(bit) * h, h - 3);
  });
}

// Stripes of the right side's colour: without colours, too, it is not the left.
function striped(c) {
  const tile = make('canvas');
  const size = Math.round(5 * ratio);
  tile.width = tile.height = size;
  const pen = tile.getContext('2d');
  pen.fillStyle = css.right;
  pen.fillRect(0, 0, size, size);
  pen.strokeStyle = css.panel;
  pen.lineWidth = 1.3 * ratio;
  for (const x of [-size, 0, size]) {
    pen.moveTo(x, size);
    pen.lineTo(x + size, 0);
  }
  pen.stroke();
  return c.createPattern(tile, 'repeat');
}

// One tick for each first frame; those that would touch are one.
function drawWindows(c, clip) {
  const { y, h } = rows.windows;
  c.fillStyle = css.win;
  let last = -9;
  for (const [start] of clip.windows) {
    const x = xOf(start / clip.fps);
    if (x - last < 3 * ratio) continue;
    c.fillRect(Math.round(x), y * ratio, Math.ceil(ratio), h * ratio);
    last = x;
  }
}

// The window whose first frame is nearest; with `inside` the one around an instant whose middle is nearest.
function windowAt(s, inside) {
  const clip = state.clip;
  const away = ([start, length]) => Math.abs((start + (inside ? length / 2 : 0)) / clip.fps - s);
  const found = clip.windows.filter(
    ([start, length]) => !inside || (start / clip.fps <= s + 1e-6 && s < (start + length) / clip.fps),
  );
  return found.length ? found.reduce((a, b) => (away(a) <= away(b) ? a : b)) : null;
}

export function loopAt(s, inside = true) {
  const found = windowAt(s, inside);
  if (found) setLoop([found[0], found[0] + found[1]]);
  return !!found;
}

const overWindows = y => y >= rows.windows.y - 4 && y < rows.windows.y + rows.windows.h + 4;

// The window under the pointer is a bar, and in words beside the clock.
function hover(e) {
  const y = e.offsetY;
  lanes.style.cursor = inMap(y) ? 'ew-resize' : '';
  const found = state.clip && e.type !== 'pointerleave' && overWindows(y) ? windowAt(secondsAt(e), false) : null;
  if (found !== state.hovered) {
    state.hovered = found;
    state.dirty = true;
  }
}

// The dancer whose lane is at a height; null where there is none.
const laneAt = y => {
  const k = state.clip.members.findIndex((_, at) => {
    const row = rows[`dancer${at}`];
    return y >= row.y && y < row.y + row.h;
  });
  return k < 0 ? null : k;
};

let scrubbing = false;
on(lanes, 'pointerdown', e => {
  if (!state.clip) return;
  const y = e.offsetY;
  const k = together() && e.offsetX < LABEL ? laneAt(y) : null;
  if (k !== null) {
    lanes.dispatchEvent(new CustomEvent('dancer', { detail: k }));
    return;
  }
  if (overWindows(y) && loopAt(secondsAt(e), false)) return;
  lanes.setPointerCapture(e.pointerId);
  if (inMap(y)) {
    grabMap(e.offsetX);
    return;
  }
  scrubbing = true;
  seek(secondsAt(e));
});

on(lanes, 'pointermove', e => {
  if (scrubbing) seek(secondsAt(e));
  else if (!dragMap(e.offsetX)) hover(e);
});
on(lanes, 'pointerleave', hover);

for (const end of ['pointerup', 'pointercancel'])
  on(lanes, end, () => {
    scrubbing = false;
    dropMap();
  });

on(lanes, 'dblclick', () => zoomTo(0, duration()));
on(
  lanes,
  'wheel',
  e => {
    if (!state.clip) return;
    e.preventDefault();
    if (e.shiftKey || Math.abs(e.deltaX) > Math.abs(e.deltaY)) moveBy((e.deltaX || e.deltaY) * 0.001);
    else zoomAround(secondsAt(e), Math.exp(e.deltaY * 0.0015));
  },
  { passive: false },
);

// Draws the time axis anew, and with it the page.
export function redraw() {
  base = null;
  state.dirty = true;
}
