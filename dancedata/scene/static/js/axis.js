// The time axis: its canvas, its scale, and what is drawn in every lane. Heights in CSS pixels.
import { el, on } from './data.js';
import { css, ratio } from './figure.js';
import { duration, state } from './state.js';

export const lanes = el('lanes');
// Width left of the time axis: names, and on walls what is measured.
export let LABEL = 74;
export const view = { from: 0, to: 0 };
// Top and height of each lane, by name.
export const rows = {};

export const xOf = s => (LABEL + ((s - view.from) / (view.to - view.from)) * (lanes.width / ratio - LABEL)) * ratio;

// Seconds of a CSS pixel.
const perPixel = () => (view.to - view.from) / Math.max(1, lanes.width / ratio - LABEL);

export function drawCurve(c, curve, row, colour, width) {
  c.strokeStyle = colour;
  c.lineWidth = width * ratio;
  c.beginPath();
  // Means of what falls on two pixels: a line through more would be a block.
  const each = Math.max(1, Math.floor(curve.rate * perPixel() * 2));
  const first = Math.max(0, Math.floor(view.from * curve.rate) - 1);
  for (let i = first - (first % each); i < curve.values.length && i / curve.rate <= view.to + 1; i += each) {
    const part = each > 1 ? curve.values.subarray(i, i + each) : [curve.values[i]];
    const mean = part.reduce((sum, v) => sum + v, 0) / part.length;
    c.lineTo(
      xOf((i + (part.length - 1) / 2) / curve.rate + curve.delay),
      (row.y + row.h - (mean / (curve.max || 1)) * row.h) * ratio,
    );
  }
  c.stroke();
}

// Speed and key motions of a dancer, `max` at the top of the row.
export function drawSpeed(c, dancer, row, max, colour, size) {
  const speed = dancer.speed;
  drawCurve(c, { ...speed, max }, row, colour, 1.5);
  c.fillStyle = css.ink;
  const keys = (dancer.keys || []).filter(([at]) => at >= view.from && at <= view.to);
  if (keys.length * perPixel() * 5 > view.to - view.from) return;
  for (const [at, deep] of keys) {
    if (deep < speed.max * 0.03) continue;
    const i = Math.max(0, Math.min(speed.values.length - 1, Math.round((at - speed.delay) * speed.rate)));
    const x = xOf(at);
    const y = (row.y + row.h - (speed.values[i] / (max || 1)) * row.h) * ratio;
    const r = size * ratio;
    c.beginPath();
    c.moveTo(x, y - r);
    c.lineTo(x + r, y);
    c.lineTo(x, y + r);
    c.lineTo(x - r, y);
    c.fill();
  }
}

export function setLabel(width) {
  LABEL = width;
}

export function zoomTo(from, to) {
  const length = Math.max(Math.min(duration(), 0.5), Math.min(duration(), to - from));
  view.from = Math.max(0, Math.min(duration() - length, from));
  view.to = view.from + length;
  state.dirty = true;
}

export function zoomAround(s, factor) {
  const at = Math.max(view.from, Math.min(view.to, s));
  const span = Math.max(0.5, (view.to - view.from) * factor);
  const left = ((at - view.from) / (view.to - view.from)) * span;
  zoomTo(at - left, at - left + span);
}

// By a share of what is seen.
export function moveBy(share) {
  const by = (view.to - view.from) * share;
  zoomTo(view.from + by, view.to + by);
}

// Bars from the first to the last frame of each stretch.
export function drawSpans(c, spans, rate, y, height) {
  const least = spans.length * perPixel() * 4 > view.to - view.from ? 0 : ratio;
  for (const [start, end] of spans)
    c.fillRect(xOf(start / rate), y * ratio, Math.max(least, xOf(end / rate) - xOf(start / rate)), height * ratio);
}

// Stretches of frames in which a foot joint is in contact: some bit of `bits` is set.
export function contactSpans(figure, bits) {
  const spans = [];
  for (let i = 0, begin = -1; i <= figure.frames; i++) {
    const on = i < figure.frames && figure.contacts[i] & bits;
    if (on && begin < 0) begin = i;
    if (!on && begin >= 0) {
      spans.push([begin, i]);
      begin = -1;
    }
  }
  return spans;
}

// A sentence for each lane, at its name.
const SENTENCES = {
  music: 'The song; a line for each beat, green where the body rests on it',
  speed: 'How fast the body moves; a diamond where it comes to rest',
  distance: 'How far the dancer is from the one who is compared',
  contact: 'When each joint of a foot is on the floor',
  windows: 'What a model gets at a time: a tick where each window begins; a click loops it',
  flags: 'Where the motion may be wrong',
  map: 'The whole clip; drag what is shown',
};
on(lanes, 'pointermove', e => {
  const at = Object.keys(rows).find(name => e.offsetY >= rows[name].y && e.offsetY < rows[name].y + rows[name].h);
  lanes.title = (e.offsetX < LABEL && SENTENCES[at]) || '';
});

// Shows the sentences in their lanes until the first click or key; once, where the browser remembers it.
export function explainLanes() {
  try {
    if (localStorage.getItem('dancedata-lanes')) return;
    localStorage.setItem('dancedata-lanes', 'explained');
  } catch {
    // such as in a sandboxed frame
  }
  const box = document.createElement('div');
  box.className = 'sentences';
  for (const [name, row] of Object.entries(rows).filter(([lane]) => SENTENCES[lane])) {
    const line = document.createElement('p');
    line.textContent = SENTENCES[name];
    line.style.top = `${lanes.offsetTop + row.y + row.h / 2}px`;
    line.style.left = `${lanes.offsetLeft + LABEL + 8}px`;
    box.append(line);
  }
  lanes.after(box);
  for (const kind of ['pointerdown', 'keydown', 'resize'])
    on(window, kind, () => box.remove(), { once: true, capture: true });
}
