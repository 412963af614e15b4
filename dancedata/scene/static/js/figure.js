// The stage: the dancer in perspective, drawn on a canvas.
import { blend, conesOf, drawCones, spotOf } from './body.js';
import { el } from './data.js';
import { drawSkin, drawSkinShadow, rowsOf } from './gl.js';
import { camera, frameRate, SKIN, state } from './state.js';

export const canvas = el('figure');
export const pen = canvas.getContext('2d');
const COLOURS = [
  'bg',
  'panel',
  'line',
  'ink',
  'dim',
  'accent',
  'left',
  'right',
  'mid',
  'contact',
  'flag',
  'floor',
  'shadow',
  'pool',
  'wave',
  'win',
  'other',
];

export const css = {};
export const fontOf = (size, weight = 400) => `${weight} ${size * ratio}px system-ui,"DejaVu Sans",sans-serif`;
export let ratio = 1;
export let project = null;
export let far = 1;

export function readColours() {
  const style = getComputedStyle(document.documentElement);
  for (const name of COLOURS) css[name] = style.getPropertyValue(`--${name}`).trim();
}

export function sizeCanvas(target) {
  ratio = Math.min(2, window.devicePixelRatio || 1);
  const box = target.getBoundingClientRect();
  const w = Math.round(box.width * ratio);
  const h = Math.round(box.height * ratio);
  if (target.width !== w || target.height !== h) {
    target.width = w;
    target.height = h;
    state.dirty = true;
  }
}

// Returns a function from metres to [x, y, depth, pixels a metre]; null behind the camera.
export function aim(distance) {
  far = distance;
  const w = canvas.width;
  const h = canvas.height;
  const focus = h * 1.25;
  const cy = Math.cos(camera.yaw);
  const sy = Math.sin(camera.yaw);
  const cp = Math.cos(camera.pitch);
  const sp = Math.sin(camera.pitch);
  project = (x, y, z) => {
    x -= camera.x;
    y -= camera.y;
    z -= camera.z;
    const right = x * cy - z * sy;
    const away = x * sy + z * cy;
    const up = y * cp - away * sp;
    const depth = distance - (y * sp + away * cp);
    return depth < 0.1
      ? null
      : [
          w / 2 + h * camera.right + (right * focus) / depth,
          h * (0.5 + camera.up) - (up * focus) / depth,
          depth,
          focus / depth,
        ];
  };
}

export function stroke(a, b, width, colour) {
  if (!a || !b) return;
  pen.strokeStyle = colour;
  pen.lineWidth = width;
  pen.beginPath();
  pen.moveTo(a[0], a[1]);
  pen.lineTo(b[0], b[1]);
  pen.stroke();
}

// Joints at a time, between two frames; returns the frame that is shown.
export function pose(figure, t, out) {
  const at = Math.max(0, Math.min(figure.frames - 1, t * figure.rate));
  const k = figure.width;
  const i = Math.max(0, Math.min(figure.frames - 2, at | 0));
  const u = at - i;
  const a = i * k;
  const b = figure.frames > 1 ? a + k : a;
  for (let j = 0; j < k; j++) out[j] = figure.places[a + j] * (1 - u) + figure.places[b + j] * u;
  return Math.min(figure.frames - 1, Math.floor(at + 1e-4));
}

function mirrored(figure, places) {
  const out = new Float32Array(places.length);
  const axis = figure.places[0];
  for (let j = 0; j < figure.count; j++) {
    const m = figure.mirror[j] * 3;
    out[3 * j] = 2 * axis - places[m];
    out[3 * j + 1] = places[m + 1];
    out[3 * j + 2] = places[m + 2];
  }
  return out;
}

function drawContacts(figure, places, frame, shift, swap) {
  figure.feet.forEach((joint, bit) => {
    if (!((figure.contacts[frame] >> bit) & 1)) return;
    const j = 3 * (swap ? figure.mirror[joint] : joint);
    const p = project(places[j] + shift[0], figure.floor, places[j + 2] + shift[1]);
    if (!p) return;
    const r = ((0.085 * figure.tall) / 1.7) * p[3];
    pen.strokeStyle = css.contact;
    pen.lineWidth = 2.6 * ratio;
    pen.beginPath();
    pen.ellipse(p[0], p[1], r, r * Math.max(0.18, Math.sin(camera.pitch)), 0, 0, 7);
    pen.stroke();
  });
}

export function triangle(ink, x, y, r, colour, edge) {
  ink.beginPath();
  ink.moveTo(x, y - r);
  ink.lineTo(x + r, y + r * 0.8);
  ink.lineTo(x - r, y + r * 0.8);
  ink.closePath();
  ink.fillStyle = colour;
  ink.fill();
  if (edge) {
    ink.strokeStyle = edge;
    ink.lineWidth = 1.5 * ratio;
    ink.stroke();
  }
}

const hasSkin = figure => state.body === SKIN && figure.turning;

// A blob under each joint, the darker the lower the joint is; with a skin, its own shadow.
export function drawShadow(figure, places, { shift = [0, 0], swap = false, thin = false, alpha = 1 }) {
  if (hasSkin(figure)) {
    rowsOf(figure, places, state.t, shift, swap);
    drawSkinShadow(pen, figure, far, css.shadow, thin ? 0.3 : alpha);
    return;
  }
  const spot = spotOf(css.shadow);
  const scale = figure.tall / 1.7;
  const flat = Math.max(0.15, Math.sin(camera.pitch));
  for (let j = 0; j < figure.count; j++) {
    if (j && !figure.thick[j]) continue;
    const p = project(places[3 * j] + shift[0], figure.floor, places[3 * j + 2] + shift[1]);
    if (!p) continue;
    const high = Math.max(0, places[3 * j + 1] - figure.floor) / scale;
    const r = (0.11 + Math.max(...figure.girths[j]) + 0.12 * high) * scale * p[3];
    pen.globalAlpha = (thin ? 0.3 : 0.95) * alpha * Math.exp(-2.4 * Math.max(0, high - 0.03));
    pen.drawImage(spot, p[0] - r, p[1] - r * flat, 2 * r, 2 * r * flat);
  }
  pen.globalAlpha = 1;
}

// Where the head faces at a time; null where that is unknown.
function lookAt(figure, t, mirrored) {
  if (!figure.look) return null;
  const at = Math.max(0, Math.min(figure.frames - 1, t * figure.rate));
  const i = Math.floor(at);
  const next = Math.min(figure.frames - 1, i + 1);
  const look = [0, 1, 2].map(k => figure.look[3 * i + k] * (1 - at + i) + figure.look[3 * next + k] * (at - i));
  const long = Math.hypot(...look) || 1;
  return look.map((v, k) => (mirrored && !k ? -v : v) / long);
}

// Where the dancer faces now, as a turn of the camera; 0 where that is unknown.
export function facingNow() {
  const look = state.clip.figure && lookAt(state.clip.figure, state.t, false);
  return look ? Math.atan2(look[0], look[2]) : 0;
}

// `thin`: a figure that lies over another one is drawn as lines in a colour of its own. `colours`: middle, left, right.
export function drawBody(figure, places, frame, options) {
  const { shift = [0, 0], swap = false, thin = false, alpha = 1, label = '', colours = null } = options;
  // Not transparent: parts behind others would show through.
  const tones = (colours || [swap ? css.ink : css.mid, css.left, css.right]).map(tone => blend(tone, css.bg, alpha));
  const points = [];
  for (let j = 0; j < figure.count; j++)
    points.push(project(places[3 * j] + shift[0], places[3 * j + 1], places[3 * j + 2] + shift[1]));
  if (!colours) drawShadow(figure, places, options); // those of a group lie below all dancers
  pen.lineCap = 'round';
  pen.globalAlpha = alpha;
  drawContacts(figure, places, frame, shift, swap);
  pen.globalAlpha = 1;
  if (hasSkin(figure)) {
    rowsOf(figure, places, state.t, shift, swap);
    const skin = thin ? [css.other, css.other, css.other] : tones;
    drawSkin(pen, figure, far, [...skin, blend(skin[0], '#000000', 0.35)], thin ? 0.35 : 1);
  } else if (state.body && !thin) {
    const cones = conesOf(figure, places, lookAt(figure, state.t, swap));
    drawCones(pen, cones, project, shift, [...tones, blend(tones[0], '#000000', 0.35)]);
  } else drawSticks(figure, points, thin, thin ? [blend(css.other, css.bg, alpha)] : tones);
  if (label && points[0]) {
    const p = project(places[0] + shift[0], figure.floor, places[2] + shift[1]);
    pen.fillStyle = thin ? css.other : css.dim;
    pen.textAlign = 'center';
    pen.font = fontOf(12);
    if (p)
      pen.fillText(label, p[0], Math.min(canvas.height - 34 * ratio, p[1] + ((0.24 * figure.tall) / 1.7) * p[3]));
  }
  if (state.pointed && !thin) drawHands(figure, points);
  return points;
}

// The last joint of a side's arm, whatever its hand is called.
const handOf = (figure, side) =>
  ['hand', 'wrist']
    .map(name =>
      figure.joints.findLastIndex((joint, j) => figure.sides[j] === side && joint.toLowerCase().endsWith(name)),
    )
    .find(j => j >= 0);

function drawHands(figure, points) {
  pen.font = fontOf(13, 700);
  pen.textAlign = 'center';
  pen.textBaseline = 'middle';
  pen.lineWidth = 3.5 * ratio;
  pen.lineJoin = 'round';
  pen.strokeStyle = css.bg;
  pen.fillStyle = css.ink;
  for (const side of [1, 2]) {
    const p = points[handOf(figure, side)];
    if (!p) continue;
    pen.strokeText(' LR'[side], p[0], p[1]);
    pen.fillText(' LR'[side], p[0], p[1]);
  }
  pen.textBaseline = 'alphabetic';
}

function drawSticks(figure, points, thin, tones) {
  const parents = figure.parents;
  const order = [];
  for (let j = 1; j < figure.count; j++) if (points[j] && points[parents[j]] && figure.thick[j]) order.push(j);
  order.sort((a, b) => points[b][2] + points[parents[b]][2] - points[a][2] - points[parents[a]][2]);
  for (const j of order) {
    const a = points[parents[j]];
    const b = points[j];
    const width = ((figure.thick[j] * (a[3] + b[3])) / 2) * (thin ? 0.3 : 1);
    if (!thin) stroke(a, b, width + 2.5 * ratio, css.bg);
    stroke(a, b, Math.max(width, 1.2 * ratio), tones[thin ? 0 : figure.sides[j]]);
    if (j === figure.head) {
      pen.beginPath();
      pen.arc(b[0], b[1] - 0.03 * b[3], ((0.095 * figure.tall) / 1.7) * b[3], 0, 7);
      pen.fillStyle = pen.strokeStyle = tones[0];
      pen.lineWidth = 1.6 * ratio;
      thin ? pen.stroke() : pen.fill();
    }
  }
}

// `beyond`: how far the dancers of a group are from the middle, metres.
export function drawFloor(figure, beyond = 0) {
  const step = figure.tall / 3.4;
  const reach = Math.min(40, 6 + Math.ceil(beyond / step));
  const sx = Math.round(camera.x / step);
  const sz = Math.round(camera.z / step);
  const y = figure.floor;
  const middle = project(camera.x, y, camera.z);
  if (middle) {
    // A pool of light, on which shadows are seen.
    const r = step * (reach + 1) * middle[3];
    const flat = Math.max(0.15, Math.sin(camera.pitch));
    pen.drawImage(spotOf(css.pool), middle[0] - r, middle[1] - r * flat, 2 * r, 2 * r * flat);
  }
  for (let k = -reach; k <= reach; k++) {
    const bold = i => (i % 2 ? 0.9 : 1.6) * ratio;
    const at = (i, j) => project(i * step, y, j * step);
    stroke(at(sx + k, sz - reach), at(sx + k, sz + reach), bold(sx + k), css.floor);
    stroke(at(sx - reach, sz + k), at(sx + reach, sz + k), bold(sz + k), css.floor);
  }
}

export function drawPath(figure, shift, from, to, width, colour, alpha) {
  pen.globalAlpha = alpha;
  pen.strokeStyle = colour;
  pen.lineWidth = width;
  pen.lineJoin = 'round';
  pen.beginPath();
  let up = true;
  // At most 600 points: strokes of longer paths take longer than the rest of the picture.
  const stride = Math.max(2, Math.ceil((to - from) / 600));
  if (stride > 8) pen.globalAlpha = 0.4 * alpha;
  for (let i = from; i <= to; i += stride) {
    const p = project(
      figure.places[i * figure.width] + shift[0],
      figure.floor,
      figure.places[i * figure.width + 2] + shift[1],
    );
    if (p) up ? pen.moveTo(p[0], p[1]) : pen.lineTo(p[0], p[1]);
    up = !p;
  }
  pen.stroke();
  pen.globalAlpha = 1;
}

const here = new Float32Array(3 * 1024);
const there = new Float32Array(3 * 1024);

// The cones of the clip's figure, as they are drawn now.
export const conesNow = () => conesOf(state.clip.figure, here, lookAt(state.clip.figure, state.t, false));

// Where the joints are on the canvas, of a dancer alone.
export const pointsNow = () =>
  Array.from({ length: state.clip.figure.count }, (_, j) => project(here[3 * j], here[3 * j + 1], here[3 * j + 2]));

// Where the joints of the skin are now, from their rest pose: three rows of a matrix each.
export const placingNow = swap =>
  Array.from(rowsOf(state.clip.figure, swap ? mirrored(state.clip.figure, here) : here, state.t, [0, 0], swap)).slice(
    0,
    12 * state.clip.figure.count,
  );

export function drawStage() {
  pen.fillStyle = css.bg;
  pen.fillRect(0, 0, canvas.width, canvas.height);
  const clip = state.clip;
  const figure = clip.figure;
  const waits = clip.partial && state.t * figure?.rate > figure?.frames;
  if (!figure || waits) {
    state.drawn = Math.floor(state.t * clip.fps + 1e-4);
    return;
  }
  const other = state.other?.figure;
  const frame = pose(figure, state.t, here);
  const move = state.playing && !camera.still ? 0.25 : 1;
  if (state.follow || !camera.placed) {
    camera.x += (here[0] - camera.x) * move;
    camera.z += (here[2] - camera.z) * move;
  }
  camera.placed = true;
  // Near by, at the chest.
  const aimed = figure.room * (0.47 + 0.25 * Math.max(0, 1 - camera.zoom));
  camera.y = figure.floor + aimed + Math.max(0, here[1] - figure.floor - figure.room);
  camera.still = false;
  const copies = (state.mirror ? 1 : 0) + (other && !state.over ? 1 : 0);
  const wide = copies && !state.over ? 1.25 + 0.9 * copies : 1.05;
  const across = (figure.room * wide * 1.25 * canvas.height) / canvas.width;
  aim(Math.max(figure.room * 1.85, across) * camera.zoom);
  drawFloor(figure);
  const gap = figure.tall * 0.85;
  const right = [Math.cos(camera.yaw) * gap, -Math.sin(camera.yaw) * gap];
  const place = k => {
    const at = k - copies / 2;
    return [right[0] * at, right[1] * at];
  };
  drawPath(figure, place(0), 0, figure.frames - 1, 1.2 * ratio, css.dim, 0.5);
  const near = Math.round(10 * figure.rate);
  if (figure.frames > 4 * near)
    drawPath(
      figure,
      place(0),
      Math.max(0, frame - near),
      Math.min(figure.frames - 1, frame + near),
      1.2 * ratio,
      css.dim,
      0.6,
    );
  drawPath(figure, place(0), Math.max(0, frame - Math.round(1.5 * figure.rate)), frame, 2.6 * ratio, css.accent, 0.9);
  const points = drawBody(figure, here, frame, {
    shift: place(0),
    label: copies && !(other && state.over) ? 'this' : '',
  });
  let k = 1;
  if (state.mirror)
    drawBody(figure, mirrored(figure, here), frame, {
      shift: place(k++),
      swap: true,
      alpha: 0.85,
      label: 'mirrored',
    });
  if (other) {
    const at = pose(other, state.t, there);
    const root = [there[0], there[2]];
    const past = state.t * other.rate > other.frames - 0.5;
    const beside = place(k);
    const shift = state.over ? place(0) : [here[0] - root[0] + beside[0], here[2] - root[1] + beside[1]];
    drawBody(other, there, at, {
      shift,
      thin: state.over,
      alpha: past ? 0.35 : state.over ? 1 : 0.9,
      label: past ? `${state.other.name} has ended` : state.other.name,
    });
  }
  for (const f of flagsNear()) {
    const p = points[figure.joints.indexOf(f[2])];
    if (p) triangle(pen, p[0], p[1] - 15 * ratio, 7 * ratio, css.flag, css.bg);
  }
  state.drawn = frame;
}

// A flag is shown for a fifth of a second around its frame, and a little longer while the clip plays.
export const flagsNear = () =>
  state.clip.flags.filter(
    f => f[0] !== null && Math.abs(f[0] - state.t) < (state.playing ? 0.15 : 0.6 / frameRate()),
  );
