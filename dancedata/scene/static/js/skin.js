// The skin of a body: round cones along the bones of its rest pose, melted into one surface.
import { conesOf } from './body.js';

// Metres, of a body of 1.7 m: how far shapes melt into each other, and how far a joint bends the skin around it.
const MELT = 0.022;
const BEND = 0.016;
const UP = [0, 1, 0];

// [begin, end, radius, radius, tone, joint that moves it, flatness, axis in which it is flat]
function partsOf(figure) {
  const { rest, ahead } = figure.turns;
  const scale = figure.tall / 1.7;
  const across = [ahead[2], 0, -ahead[0]];
  const shifted = (p, by, way = across) => p.map((v, k) => v + way[k] * by);
  const movers = [];
  figure.girths.forEach(([ra, rb], j) => {
    if (ra || rb) movers.push([figure.parents[j], j]);
  });
  for (const tip of figure.tips) movers.push([tip[0], tip[2]]);
  const parts = [];
  conesOf(figure, rest, ahead).forEach(([a, b, ra, rb, drawn], n, { length }) => {
    const tone = drawn === 3 && n < length - 2 ? 0 : drawn; // eyes are dark, and not the nose
    const [mover, joint] = movers[n] || [figure.head, 0];
    const hand = joint && /hand$/i.test(figure.joints[joint]);
    // The trunk is wider than deep.
    if (joint && !figure.sides[joint] && Math.min(ra, rb) > 0.09 * scale)
      for (const by of [-0.045 * scale, 0.045 * scale])
        parts.push([shifted(a, by), shifted(b, by), 0.94 * ra, 0.94 * rb, tone, mover, 0.84, ahead]);
    else parts.push([a, b, hand ? 1.25 * ra : ra, hand ? 1.2 * rb : rb, tone, mover, hand ? 0.6 : 1, UP]);
    // The thumb of a hand without fingers.
    if (hand && n < figure.girths.length - 1 && mover !== joint) {
      const thumb = shifted(b, 0.055 * scale, ahead);
      parts.push([a, thumb, 0.018 * scale, 0.011 * scale, tone, mover, 1, UP]);
    }
  });
  return parts;
}

// Distance to a round cone; well enough for melting.
function distance([a, b, ra, rb, , , flat, axis], x, y, z) {
  const bx = b[0] - a[0];
  const by = b[1] - a[1];
  const bz = b[2] - a[2];
  const px = x - a[0];
  const py = y - a[1];
  const pz = z - a[2];
  const long = bx * bx + by * by + bz * bz || 1e-9;
  const t = Math.max(0, Math.min(1, (px * bx + py * by + pz * bz) / long));
  const dx = px - bx * t;
  const dy = py - by * t;
  const dz = pz - bz * t;
  const flattened = (dx * axis[0] + dy * axis[1] + dz * axis[2]) ** 2 * (1 / flat ** 2 - 1);
  return Math.sqrt((dx * dx + dy * dy + dz * dz + flattened) * flat) - (ra + (rb - ra) * t);
}

function boundsOf(parts, margin) {
  const low = [1e9, 1e9, 1e9];
  const high = [-1e9, -1e9, -1e9];
  for (const [a, b, ra, rb] of parts)
    for (let k = 0; k < 3; k++) {
      const r = Math.max(ra, rb) + margin;
      low[k] = Math.min(low[k], a[k] - r, b[k] - r);
      high[k] = Math.max(high[k], a[k] + r, b[k] + r);
    }
  return [low, high];
}

// Distances from the skin on a grid, computed near the bones only; 1 elsewhere.
function fieldOf(figure, parts) {
  const scale = figure.tall / 1.7;
  const [low, high] = boundsOf(parts, 0.04 * scale);
  let cell = scale * (figure.count > 30 ? 0.0115 : 0.014);
  const sizes = () => low.map((v, k) => Math.ceil((high[k] - v) / cell) + 1);
  while (sizes().reduce((a, b) => a * b) > 4e6) cell *= 1.3;
  const n = sizes();
  const values = new Float32Array(n[0] * n[1] * n[2]).fill(1);
  for (const part of parts) {
    const [from, to] = boundsOf([part], MELT * scale + 2 * cell);
    const first = from.map((v, k) => Math.max(0, Math.floor((v - low[k]) / cell)));
    const last = to.map((v, k) => Math.min(n[k] - 1, Math.ceil((v - low[k]) / cell)));
    const soft = Math.min(MELT * scale, 0.7 * Math.min(part[2], part[3]));
    for (let k = first[2]; k <= last[2]; k++)
      for (let j = first[1]; j <= last[1]; j++)
        for (let i = first[0], q = i + n[0] * (j + n[1] * k); i <= last[0]; i++, q++) {
          const d = distance(part, low[0] + i * cell, low[1] + j * cell, low[2] + k * cell);
          const h = Math.max(0, soft - Math.abs(d - values[q]));
          values[q] = Math.min(d, values[q]) - (h * h) / (4 * soft);
        }
  }
  cutSoles(figure, values, n, low, cell);
  return { values, n, low, cell };
}

// Soles are flat, where the feet of the rest pose are its lowest joints.
function cutSoles(figure, values, n, low, cell) {
  const heights = figure.turns.rest.filter((_, k) => k % 3 === 1);
  const least = Math.min(...figure.feet.map(j => heights[j]));
  if (Math.min(...heights) < least - 1e-6) return;
  const sole = least - (0.025 * figure.tall) / 1.7;
  for (let k = 0; k < n[2]; k++)
    for (let j = 0; j < n[1] && low[1] + j * cell < sole + 0.02; j++)
      for (let i = 0, q = n[0] * (j + n[1] * k); i < n[0]; i++, q++)
        values[q] = Math.max(values[q], sole - low[1] - j * cell);
}

const CORNERS = [0, 1, 2, 3, 4, 5, 6, 7];

// The surface where a field is 0 (surface nets): one vertex a cell, one quad an edge of the grid that it crosses.
function surface({ values, n, low, cell }) {
  const at = [];
  const faces = [];
  const vertex = new Int32Array(values.length).fill(-1);
  const step = [1, n[0], n[0] * n[1]];
  const corner = CORNERS.map(c => (c & 1) + step[1] * ((c >> 1) & 1) + step[2] * (c >> 2));
  for (let k = 0; k < n[2] - 1; k++)
    for (let j = 0; j < n[1] - 1; j++)
      for (let i = 0, q = n[0] * (j + n[1] * k); i < n[0] - 1; i++, q++) {
        let inside = 0;
        for (const c of corner) inside += values[q + c] < 0;
        if (!inside || inside === 8) continue;
        const sum = [0, 0, 0];
        let m = 0;
        for (const a of CORNERS)
          for (const bit of [1, 2, 4]) {
            const b = a | bit;
            const va = values[q + corner[a]];
            const vb = values[q + corner[b]];
            if (b === a || va < 0 === vb < 0) continue;
            const t = va / (va - vb);
            for (let d = 0; d < 3; d++) sum[d] += ((a >> d) & 1) + (bit === 1 << d ? t : 0);
            m++;
          }
        vertex[q] = at.length / 3;
        at.push(...[i, j, k].map((v, d) => low[d] + (v + sum[d] / m) * cell));
      }
  for (let k = 1; k < n[2] - 1; k++)
    for (let j = 1; j < n[1] - 1; j++)
      for (let i = 1, q = 1 + n[0] * (j + n[1] * k); i < n[0] - 1; i++, q++)
        for (let a = 0; a < 3; a++) {
          const inside = values[q] < 0;
          if (inside === values[q + step[a]] < 0) continue;
          const u = step[(a + 1) % 3];
          const v = step[(a + 2) % 3];
          const f = [q - u - v, q - v, q, q - u].map(w => vertex[w]);
          if (f.includes(-1)) continue;
          faces.push(...(inside ? [f[0], f[1], f[2], f[0], f[2], f[3]] : [f[0], f[2], f[1], f[0], f[3], f[2]]));
        }
  return { at: Float32Array.from(at), faces: Uint32Array.from(faces) };
}

function normalsOf({ at, faces }) {
  const normal = new Float32Array(at.length);
  for (let t = 0; t < faces.length; t += 3) {
    const [a, b, c] = [3 * faces[t], 3 * faces[t + 1], 3 * faces[t + 2]];
    const e = [0, 1, 2].map(k => at[b + k] - at[a + k]);
    const g = [0, 1, 2].map(k => at[c + k] - at[a + k]);
    for (const v of [a, b, c])
      for (let k = 0; k < 3; k++) normal[v + k] += e[(k + 1) % 3] * g[(k + 2) % 3] - e[(k + 2) % 3] * g[(k + 1) % 3];
  }
  return normal;
}

// The skin of a figure at rest: vertices (3 numbers each), normals (not of unit length), the joints that move each and
// their weights (4, of 255), shares of left, right and face in its colour (of 255), and triangles.
export function grow(figure) {
  const parts = partsOf(figure);
  const mesh = surface(fieldOf(figure, parts));
  const { rest, ahead } = figure.turns;
  const scale = figure.tall / 1.7;
  const count = mesh.at.length / 3;
  const bones = new Uint8Array(4 * count);
  const weights = new Uint8Array(4 * count);
  const tint = new Uint8Array(4 * count);
  for (let v = 0; v < count; v++) {
    const p = mesh.at.subarray(3 * v, 3 * v + 3);
    // Which side of the body: limbs of the other side neither move nor colour it.
    const left = (p[0] - rest[0]) * ahead[2] - (p[2] - rest[2]) * ahead[0];
    const away = tone => (tone === 1 && left < -0.004) || (tone === 2 && left > 0.004);
    const near = parts.map(part => (away(part[4]) ? 9 : distance(part, p[0], p[1], p[2])));
    const least = Math.min(...near);
    const moved = new Map();
    const tones = [0, 0, 0, 0];
    parts.forEach(([, , ra, rb, tone, mover], k) => {
      const w = Math.exp((least - near[k]) / (BEND * scale * Math.min(1, (25 / scale) * Math.min(ra, rb))));
      if (w < 0.004) return;
      moved.set(mover, Math.max(moved.get(mover) || 0, w));
      tones[tone] += w;
    });
    const all = tones.reduce((a, b) => a + b);
    const top = [...moved].sort((a, b) => b[1] - a[1]).slice(0, 4);
    const sum = top.reduce((a, b) => a + b[1], 0);
    top.forEach(([joint, w], k) => {
      bones[4 * v + k] = joint;
      weights[4 * v + k] = Math.round((255 * w) / sum);
    });
    for (let k = 0; k < 3; k++) tint[4 * v + k] = (255 * tones[k + 1]) / all;
  }
  return { ...mesh, normal: normalsOf(mesh), bones, weights, tint };
}
