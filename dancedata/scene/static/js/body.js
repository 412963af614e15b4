// The body: round cones along the bones, lit from above and the right, and soft blobs for shadows.
import { make } from './data.js';

export const channels = colour => [1, 3, 5].map(i => Number.parseInt(colour.slice(i, i + 2), 16));

// A share of one colour, the rest of another.
export function blend(colour, other, share) {
  const below = channels(other);
  const mixed = channels(colour).map((v, k) => Math.round(v * share + below[k] * (1 - share)));
  return `#${mixed.map(v => v.toString(16).padStart(2, '0')).join('')}`;
}

const shadeOf = new Map();

// The edge and the highlight of a colour.
function shades(colour) {
  if (!shadeOf.has(colour)) shadeOf.set(colour, [blend(colour, '#000000', 0.5), blend(colour, '#ffffff', 0.68)]);
  return shadeOf.get(colour);
}

// Ends in pixels, radii in pixels.
function drawCone(pen, a, b, ra, rb, colour) {
  const dx = b[0] - a[0];
  const dy = b[1] - a[1];
  const long = Math.hypot(dx, dy);
  const [nx, ny] = long > 1e-6 ? [-dy / long, dx / long] : [1, 0];
  const r = Math.max(ra, rb);
  const across = pen.createLinearGradient(a[0] - nx * r, a[1] - ny * r, a[0] + nx * r, a[1] + ny * r);
  const lit = 0.5 + 0.17 * (0.55 * nx - 0.83 * ny);
  const [edge, light] = shades(colour);
  across.addColorStop(0, edge);
  across.addColorStop(0.16, colour);
  across.addColorStop(lit - 0.17, colour);
  across.addColorStop(lit, light);
  across.addColorStop(lit + 0.17, colour);
  across.addColorStop(0.84, colour);
  across.addColorStop(1, edge);
  pen.fillStyle = across;
  const turn = Math.atan2(dy, dx);
  const open = Math.acos(Math.max(-1, Math.min(1, (ra - rb) / (long || 1))));
  pen.beginPath();
  pen.arc(a[0], a[1], ra, turn + open, turn - open + 2 * Math.PI);
  pen.arc(b[0], b[1], rb, turn - open, turn + open);
  pen.closePath();
  pen.fill();
}

const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const along = (a, b, by) => [a[0] + b[0] * by, a[1] + b[1] * by, a[2] + b[2] * by];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const unit = a => along([0, 0, 0], a, 1 / Math.max(1e-9, Math.hypot(...a)));

// The direction of a bone, turned upwards in its vertical plane.
function turned(bone, by) {
  const flat = Math.hypot(bone[0], bone[2]);
  const ahead = Math.cos(by) * flat - Math.sin(by) * bone[1];
  const [east, south] = flat > 1e-9 ? [bone[0] / flat, bone[2] / flat] : [1, 0];
  return unit([east * ahead, Math.sin(by) * flat + Math.cos(by) * bone[1], south * ahead]);
}

// The cones of a pose: [begin, end, radius, radius, tone], metres. As `Limbs.cones` in Python.
export function conesOf(figure, places, look) {
  const at = j => [places[3 * j], places[3 * j + 1], places[3 * j + 2]];
  const cones = [];
  figure.girths.forEach(([ra, rb], j) => {
    if (ra || rb) cones.push([at(figure.parents[j]), at(j), ra, rb, figure.tones[j]]);
  });
  for (const [start, parent, joint, turn, long, ra, rb] of figure.tips)
    cones.push([
      at(start),
      along(at(start), turned(minus(at(joint), at(parent)), turn), long),
      ra,
      rb,
      figure.tones[joint],
    ]);
  if (!look || figure.head < 1) return cones;
  const scale = figure.tall / 1.7;
  const head = at(figure.head);
  const neck = minus(head, at(figure.parents[figure.head]));
  const up = unit(along(neck, look, -dot(neck, look)));
  const across = [
    up[1] * look[2] - up[2] * look[1],
    up[2] * look[0] - up[0] * look[2],
    up[0] * look[1] - up[1] * look[0],
  ];
  figure.skull.forEach(([u, f, v, g, side, ra, rb], k) => {
    const place = (high, ahead) =>
      along(along(along(head, up, high * scale), look, ahead * scale), across, side * scale);
    cones.push([place(u, f), place(v, g), ra * scale, rb * scale, k > 1 ? 3 : 0]);
  });
  return cones;
}

// Draws cones, the farthest first. `tones`: trunk and head, left, right, face.
export function drawCones(pen, cones, project, shift, tones) {
  const seen = [];
  for (const [begin, end, ra, rb, tone] of cones) {
    const a = project(begin[0] + shift[0], begin[1], begin[2] + shift[1]);
    const b = project(end[0] + shift[0], end[1], end[2] + shift[1]);
    if (a && b) seen.push([a[2] + b[2], a, b, ra * a[3], rb * b[3], tones[tone]]);
  }
  seen.sort((p, q) => q[0] - p[0]);
  for (const [, a, b, ra, rb, colour] of seen) drawCone(pen, a, b, ra, rb, colour);
}

const spots = new Map();

// A round spot that fades towards its edge.
export function spotOf(colour) {
  if (!spots.has(colour)) {
    const spot = make('canvas');
    spot.width = spot.height = 64;
    const pen = spot.getContext('2d');
    const fade = pen.createRadialGradient(32, 32, 0, 32, 32, 32);
    fade.addColorStop(0, colour);
    fade.addColorStop(0.4, `${colour}c0`);
    fade.addColorStop(0.75, `${colour}38`);
    fade.addColorStop(1, `${colour}00`);
    pen.fillStyle = fade;
    pen.fillRect(0, 0, 64, 64);
    spots.set(colour, spot);
  }
  return spots.get(colour);
}
