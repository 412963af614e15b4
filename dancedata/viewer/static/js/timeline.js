// The lanes of the time axis: music, speed, contacts, windows and flags, one below the other. Heights in CSS pixels.
import { contactSpans, drawCurve, drawSpans, drawSpeed, LABEL, lanes, rows, view, xOf } from './axis.js';
import { seek, setLoop } from './clock.js';
import { together } from './dancers.js';
import { css, ratio, triangle } from './figure.js';
import { drawGroupLanes, drawPairs, labelGroup, layOutGroup } from './pairs.js';
import { duration, loopSeconds, state } from './state.js';

const ink = lanes.getContext('2d');
let base = null;

export function layOut(clip) {
  let y = 20;
  const next = (name, height, gap) => {
    rows[name] = { y, h: height };
    y += height + gap;
  };
  for (const name of Object.keys(rows)) delete rows[name];
  next('music', clip.wave || clip.onset ? (together() ? 44 : 58) : 18, 4);
  if (together()) layOutGroup(clip, next);
  else next('speed', clip.speed ? 40 : 14, 6);
  if (state.other?.distance) next('distance', 30, 6);
  if (!together()) {
    rows.contact = { y, h: 11 };
    y += (clip.figure ? clip.figure.feet.length : 1) * 11 + 5;
  }
  next('windows', Math.max(14, windowRows(clip) * 3.4), 5);
  next('flags', 15, 3);
  lanes.style.height = `${y}px`;
}

// How many windows lie over each other, at most 10 rows.
function windowRows(clip) {
  if (clip.windows.length < 2) return 1;
  const stride = Math.max(1, clip.windows[1][0] - clip.windows[0][0]);
  return Math.min(10, Math.max(1, Math.ceil(clip.windows[0][1] / stride)));
}

const secondsAt = e => {
  const box = lanes.getBoundingClientRect();
  return view.from + ((e.clientX - box.left - LABEL) / (box.width - LABEL)) * (view.to - view.from);
};

function zoomTo(from, to) {
  const length = Math.max(Math.min(duration(), 0.5), Math.min(duration(), to - from));
  view.from = Math.max(0, Math.min(duration() - length, from));
  view.to = view.from + length;
  redraw();
}

export function drawLanes() {
  const clip = state.clip;
  if (state.playing && view.to - view.from < duration() && (state.t > view.to || state.t < view.from)) {
    zoomTo(state.t, state.t + view.to - view.from);
  }
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
    const copy = document.createElement('canvas');
    copy.width = lanes.width;
    copy.height = lanes.height;
    drawBase(copy.getContext('2d'), clip);
    base = { key, copy };
  }
  ink.clearRect(0, 0, lanes.width, lanes.height);
  ink.drawImage(base.copy, 0, 0);
  ink.save();
  ink.beginPath();
  ink.rect(LABEL * ratio - 6 * ratio, 0, lanes.width, lanes.height);
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
  const x = xOf(state.t);
  ink.fillStyle = css.ink;
  ink.fillRect(x - ratio * 0.75, 0, 1.5 * ratio, lanes.height);
  ink.beginPath();
  ink.moveTo(x - 5 * ratio, 0);
  ink.lineTo(x + 5 * ratio, 0);
  ink.lineTo(x, 8 * ratio);
  ink.fill();
  ink.restore();
  lanes.setAttribute('aria-valuemax', duration().toFixed(2));
  lanes.setAttribute('aria-valuenow', state.t.toFixed(2));
  lanes.setAttribute('aria-valuetext', `${state.t.toFixed(2)} seconds, frame ${state.drawn}`);
}

function drawBase(c, clip) {
  c.textBaseline = 'middle';
  c.font = `${11 * ratio}px system-ui,"DejaVu Sans",sans-serif`;
  drawAxis(c);
  const label = (text, y, colour = css.dim) => {
    c.fillStyle = colour;
    c.textAlign = 'left';
    c.fillText(text, 0, y * ratio);
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
  drawWindows(c, clip);
  for (const f of clip.flags)
    if (f[0] !== null) triangle(c, xOf(f[0]), (rows.flags.y + 7) * ratio, 5 * ratio, css.flag, null);
  c.restore();
}

function labelLanes(label, clip) {
  const mid = name => rows[name].y + rows[name].h / 2;
  label(clip.wave ? 'music' : clip.onset ? 'onset' : 'no music', mid('music'));
  if (together()) labelGroup(label, clip);
  else if (clip.speed) {
    label('speed', rows.speed.y + 12);
    label('key  ◆', rows.speed.y + 28);
  } else label('no speed', mid('speed'));
  const top = rows.distance && Math.max(1, state.other.distance.max);
  if (rows.distance) {
    label('distance', rows.distance.y + 8);
    label(`to ${state.other.distance.max < 10 ? top.toFixed(1) : top.toFixed(0)} mm`, rows.distance.y + 22);
  }
  const feet = clip.figure ? clip.figure.feet.map(j => clip.figure.joints[j]) : ['no contacts'];
  for (const [k, name] of together() ? [] : feet.entries())
    label(shortName(name), rows.contact.y + orderOf(k) * rows.contact.h + 5);
  label('windows', mid('windows'));
  label('flags', mid('flags'));
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

function drawAxis(c) {
  const span = view.to - view.from;
  const most = Math.min(16, (lanes.width / ratio - LABEL) / 34);
  const step = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 30, 60, 120, 300].find(s => span / s <= most) || 600;
  c.fillStyle = css.dim;
  for (let k = Math.ceil(view.from / step - 1e-9); k * step <= view.to + 1e-9; k++) {
    const s = k * step;
    const x = xOf(s);
    c.textAlign = x > lanes.width - 14 * ratio ? 'right' : 'center';
    c.fillText(step < 1 ? s.toFixed(1) : String(Math.round(s)), x, 7 * ratio);
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
    const each = duration() / n;
    const wide = Math.max(ratio, xOf(each) - xOf(0));
    for (let i = Math.max(0, Math.floor(view.from / each)); i < n && i * each <= view.to; i++) {
      const half = (clip.wave[i] * h * ratio) / 2;
      c.fillRect(xOf(i * each), (y + h / 2) * ratio - half, wide, 2 * half + ratio);
    }
  }
  if (clip.onset) {
    c.globalAlpha = clip.wave ? 0.75 : 1;
    drawCurve(c, clip.onset, rows.music, clip.wave ? css.ink : css.wave, clip.wave ? 1 : 1.4);
    c.globalAlpha = 1;
  }
  const last = together() ? `dancer${clip.members.length - 1}` : 'speed';
  const low = clip.speed || together() ? rows[last].y + rows[last].h : y + h;
  // Beats that nearly touch keep their points; lines would hide the music.
  const dense = clip.beats.length > 1 && (xOf(clip.beats[1]) - xOf(clip.beats[0])) / ratio < 7;
  c.fillStyle = css.accent;
  for (const beat of clip.beats) {
    const x = xOf(beat);
    if (x < 0 || x > w) continue;
    c.globalAlpha = dense ? 0.2 : 0.55;
    c.fillRect(x - ratio / 2, y * ratio, ratio, (low - y) * ratio);
    c.globalAlpha = 1;
    c.beginPath();
    c.arc(x, (y + h) * ratio, 2.3 * ratio, 0, 7);
    c.fill();
  }
}

function drawFeet(c, figure) {
  figure.feet.forEach((joint, bit) => {
    c.fillStyle = [css.mid, css.left, css.right][figure.sides[joint]];
    drawSpans(c, contactSpans(figure, 1 << bit), figure.rate, rows.contact.y + orderOf(bit) * rows.contact.h, 8);
  });
}

const windowY = (k, count) => rows.windows.y + (k % count) * 3.4;

function drawWindows(c, clip) {
  const count = windowRows(clip);
  const thick = clip.windows.length === 1 ? 6 : 2.4;
  c.fillStyle = css.win;
  clip.windows.forEach(([start, length], k) => {
    const a = xOf(start / clip.fps);
    const b = xOf((start + length) / clip.fps);
    c.fillRect(a + ratio, windowY(k, count) * ratio, Math.max(ratio, b - a - 2 * ratio), thick * ratio);
  });
}

// The window below the pointer; else the one whose middle is nearest.
function windowAt(s, y) {
  const clip = state.clip;
  const count = windowRows(clip);
  const mine = clip.windows
    .map((w, k) => ({ w, k }))
    .filter(({ w }) => w[0] / clip.fps <= s + 1e-6 && s < (w[0] + w[1]) / clip.fps);
  const away = ({ w, k }) =>
    (y === undefined ? 0 : Math.abs(windowY(k, count) + 1.2 - y) * 1000) + Math.abs((w[0] + w[1] / 2) / clip.fps - s);
  return mine.length ? mine.reduce((a, b) => (away(a) <= away(b) ? a : b)).w : null;
}

export function loopAt(s, y) {
  const found = windowAt(s, y);
  if (found) setLoop([found[0], found[0] + found[1]]);
  return !!found;
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
lanes.addEventListener('pointerdown', e => {
  if (!state.clip) return;
  const y = e.clientY - lanes.getBoundingClientRect().top;
  const w = rows.windows;
  const k = together() && e.clientX - lanes.getBoundingClientRect().left < LABEL ? laneAt(y) : null;
  if (k !== null) {
    lanes.dispatchEvent(new CustomEvent('dancer', { detail: k }));
    return;
  }
  if (y >= w.y - 2 && y < w.y + w.h + 2 && loopAt(secondsAt(e), y)) return;
  scrubbing = true;
  lanes.setPointerCapture(e.pointerId);
  seek(secondsAt(e));
});

lanes.addEventListener('pointermove', e => {
  if (scrubbing) seek(secondsAt(e));
});

lanes.addEventListener('pointerup', () => {
  scrubbing = false;
});

lanes.addEventListener('pointercancel', () => {
  scrubbing = false;
});

lanes.addEventListener('dblclick', () => zoomTo(0, duration()));
lanes.addEventListener(
  'wheel',
  e => {
    if (!state.clip) return;
    e.preventDefault();
    const span = view.to - view.from;
    if (e.shiftKey || Math.abs(e.deltaX) > Math.abs(e.deltaY)) {
      const by = span * (e.deltaX || e.deltaY) * 0.001;
      zoomTo(view.from + by, view.to + by);
    } else zoomAround(secondsAt(e), Math.exp(e.deltaY * 0.0015));
  },
  { passive: false },
);

export function zoomAround(s, factor) {
  const at = Math.max(view.from, Math.min(view.to, s));
  const span = Math.max(0.5, (view.to - view.from) * factor);
  const left = ((at - view.from) / (view.to - view.from)) * span;
  zoomTo(at - left, at - left + span);
}

// Draws the time axis anew, and with it the page.
export function redraw() {
  base = null;
  state.dirty = true;
}
