// The stage of a group: all dancers at their places in one world.
import { collidesAt, coloursOf, together, touching } from './dancers.js';
import {
  aim,
  canvas,
  css,
  drawBody,
  drawFloor,
  drawPath,
  drawShadow,
  flagsNear,
  fontOf,
  pen,
  pose,
  project,
  ratio,
  stroke,
  triangle,
} from './figure.js';
import { camera, state } from './state.js';

// Joints of the dancers as they were drawn last, for clicks.
let hits = [];
// Places of the names that are drawn: [x, y, half the width].
let names = [];

// What is drawn of a group: each dancer with a figure, his joints now, and those of the motion he is compared with.
function posed(dancers) {
  const others = state.other?.members;
  return dancers
    .map((dancer, k) => ({ k, dancer, figure: dancer.figure, other: others?.[k]?.figure }))
    .filter(one => one.figure)
    .map(one => {
      const places = new Float32Array(one.figure.width);
      const frame = pose(one.figure, state.t, places);
      return { ...one, places, frame, colours: coloursOf(one.dancer) };
    });
}

function follow(drawn, floor, room) {
  const xs = drawn.map(one => one.places[0]);
  const zs = drawn.map(one => one.places[2]);
  const move = state.playing && !camera.still ? 0.12 : 1;
  if (state.follow || !camera.placed) {
    camera.x += ((Math.min(...xs) + Math.max(...xs)) / 2 - camera.x) * move;
    camera.z += ((Math.min(...zs) + Math.max(...zs)) / 2 - camera.z) * move;
  }
  camera.placed = true;
  camera.y = floor + room * 0.47;
  camera.still = false;
}

export function drawCrowd() {
  pen.fillStyle = css.bg;
  pen.fillRect(0, 0, canvas.width, canvas.height);
  const clip = state.clip;
  const drawn = posed(together());
  hits = [];
  names = [];
  state.drawn = Math.floor(state.t * clip.fps + 1e-4);
  if (!drawn.length) return;
  state.drawn = drawn[0].frame;
  const floor = drawn[0].figure.floor;
  const room = Math.max(...drawn.map(one => one.figure.room));
  const beside = drawn.some(one => one.other) && !state.over;
  const wide = 2 * clip.reach + 1.3;
  follow(drawn, floor, room);
  const across = (wide * (beside ? 2.1 : 1) * 1.25 * canvas.height) / canvas.width;
  // Further away where dancers stand in rows, so that the first one is whole.
  const back = (clip.members.length > 4 ? 1 : 0.55) * clip.reach;
  aim((Math.max(room * 1.85, across) + back) * camera.zoom);
  drawFloor(drawn[0].figure, clip.reach * (beside ? 2 : 1));
  const half = beside ? wide / 2 : 0;
  const shift = [-Math.cos(camera.yaw) * half, Math.sin(camera.yaw) * half];
  const away = one => project(one.places[0] + shift[0], floor, one.places[2] + shift[1])?.[2] ?? 0;
  drawn.sort((a, b) => away(b) - away(a));
  for (const one of drawn) drawTrail(one, shift);
  for (const one of drawn) drawShadow(one.figure, one.places, { shift });
  for (const one of drawn) {
    const points = drawBody(one.figure, one.places, one.frame, { shift, colours: one.colours });
    hits.push({ k: one.k, points });
    drawName(one, points);
  }
  drawOthers(drawn, beside ? [-shift[0], -shift[1]] : shift, beside);
  drawTouches(clip);
  for (const f of flagsNear()) {
    const one = drawn.find(d => d.k === f[5]);
    const p = one && pointsOf(f[5])?.[one.figure.joints.indexOf(f[2])];
    if (p) triangle(pen, p[0], p[1] - 15 * ratio, 7 * ratio, css.flag, css.bg);
  }
}

const pointsOf = k => hits.find(hit => hit.k === k)?.points;

function drawTrail(one, shift) {
  const from = Math.max(0, one.frame - Math.round(1.5 * one.figure.rate));
  drawPath(one.figure, shift, from, one.frame, 2.2 * ratio, one.colours[0], 0.8);
}

function drawName(one, points) {
  const seen = points.filter(Boolean);
  if (!seen.length) return;
  const top = seen.reduce((a, b) => (b[1] < a[1] ? b : a));
  const middle = points[0] || top;
  pen.font = fontOf(12, 600);
  pen.textAlign = 'center';
  pen.lineWidth = 3 * ratio;
  pen.strokeStyle = css.bg;
  const half = pen.measureText(one.dancer.called).width / 2;
  let y = top[1] - 0.2 * middle[3] - 4 * ratio;
  const covers = ([x, height, wide]) =>
    Math.abs(x - middle[0]) < wide + half + 4 * ratio && Math.abs(height - y) < 14 * ratio;
  while (names.some(covers)) y -= 15 * ratio;
  names.push([middle[0], y, half]);
  pen.strokeText(one.dancer.called, middle[0], y);
  pen.fillStyle = one.colours[0];
  pen.fillText(one.dancer.called, middle[0], y);
}

function drawOthers(drawn, shift, beside) {
  const here = new Float32Array(3 * 1024);
  let named = state.other?.name;
  for (const one of drawn) {
    if (!one.other) continue;
    const frame = pose(one.other, state.t, here);
    const past = state.t * one.other.rate > one.other.frames - 0.5;
    drawBody(one.other, here, frame, {
      shift,
      thin: !beside,
      colours: one.colours,
      alpha: past ? 0.35 : 0.9,
      label: beside ? named : '',
    });
    named = '';
  }
}

// Lines between joints that touch, and between the roots of bodies that intersect.
function drawTouches(clip) {
  for (const [pair, contact] of touching(clip, state.t)) {
    const a = pointsOf(pair.of[0])?.[contact[2]];
    const b = pointsOf(pair.of[1])?.[contact[3]];
    if (!a || !b) continue;
    stroke(a, b, 3 * ratio, css.contact);
    pen.strokeStyle = css.contact;
    pen.lineWidth = 2.2 * ratio;
    pen.beginPath();
    pen.arc((a[0] + b[0]) / 2, (a[1] + b[1]) / 2, 9 * ratio, 0, 7);
    pen.stroke();
  }
  for (const pair of clip.pairs.filter(p => collidesAt(p, state.t))) {
    pen.setLineDash([5 * ratio, 4 * ratio]);
    stroke(pointsOf(pair.of[0])?.[0], pointsOf(pair.of[1])?.[0], 2.4 * ratio, css.flag);
    pen.setLineDash([]);
  }
}

// The dancer at a place of the canvas, in its pixels; null where nobody is.
export function dancerAt(x, y) {
  let found = null;
  let least = 26 * ratio;
  for (const { k, points } of hits)
    for (const p of points) {
      const away = p ? Math.hypot(p[0] - x, p[1] - y) : Infinity;
      if (away < least) {
        least = away;
        found = k;
      }
    }
  return found;
}
