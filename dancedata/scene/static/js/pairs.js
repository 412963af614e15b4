// The lanes of a group: one for each dancer, and those of distances and contacts between them.
import { contactSpans, drawCurve, drawSpans, drawSpeed, lanes, rows, xOf } from './axis.js';
import { coloursOf, together } from './dancers.js';
import { css, ratio, triangle } from './figure.js';
import { state } from './state.js';

export function layOutGroup(clip, next, low) {
  const n = clip.members.length;
  // The dancers on the stage have more than half of the page: what is left after the other rows is for their lanes.
  const left = innerHeight * 0.45 - (low ? 158 : 250) - (clip.pairs.length ? 96 : 0);
  const tall = Math.max(n > 6 ? 10 : 18, Math.min(low ? 18 : 30, Math.floor(left / n) - (low ? 1 : 3)));
  for (const [k] of clip.members.entries()) next(`dancer${k}`, tall, tall < 12 ? 0 : 3);
  if (!clip.pairs.length) return;
  next('apart', 32, 5);
  if (clip.pairs.length === 1) next('facing', 26, 5);
  next('touch', 9, 5);
  next('collide', 9, 5);
}

// Columns of what is measured of the dancers of a wall, beside their names: name and width.
const columnsOf = clip => {
  const most = clip.members.map(m => m.numbers || []).reduce((a, b) => (b.length > a.length ? b : a));
  return most.map(([name]) => [name, { sliding: 62, PFC: 60, distance: 58 }[name] || 44]);
};

// Width of those columns; 0 where the lanes are too narrow, or without any.
export const numbersWidth = () =>
  together() && lanes.clientWidth > 700 ? columnsOf(state.clip).reduce((sum, column) => sum + column[1], 0) : 0;

// The end of a long name, where ends differ; else its beginning.
const shortOf = (name, ends) => (name.length < 13 ? name : ends ? `…${name.slice(-11)}` : `${name.slice(0, 11)}…`);

export function labelGroup(label, clip) {
  const columns = numbersWidth() ? columnsOf(clip) : [];
  const ends = new Set(clip.members.map(m => m.called.slice(-11))).size === clip.members.length;
  for (const [k, dancer] of clip.members.entries()) {
    const row = rows[`dancer${k}`];
    const y = row.y + row.h / 2;
    label(shortOf(dancer.called, ends), y, coloursOf(dancer)[0], 0, 72);
    let x = 74;
    for (const [name, wide] of columns) {
      label(dancer.numbers?.find(pair => pair[0] === name)?.[1] || '', y, css.ink, x);
      if (!k) label(name, rows.music.y + rows.music.h - 5, css.dim, x);
      x += wide;
    }
  }
  if (!clip.pairs.length) return;
  label(clip.pairs.length > 1 ? 'nearest' : 'apart', rows.apart.y + 9);
  label(`to ${apartMax(clip).toFixed(1)} m`, rows.apart.y + 23);
  if (rows.facing) {
    label('facing', rows.facing.y + 7);
    label('0 to 180°', rows.facing.y + 20);
  }
  label('touch', rows.touch.y + 5);
  label('collide', rows.collide.y + 5);
}

const apartMax = clip => Math.max(...clip.pairs.map(pair => pair.distance.max));

export function drawGroupLanes(c) {
  const dancers = together();
  const max = Math.max(...dancers.map(dancer => dancer.speed?.max || 0));
  for (const [k, dancer] of dancers.entries()) drawDancer(c, dancer, rows[`dancer${k}`], max);
}

function drawDancer(c, dancer, row, max) {
  const [middle, left, right] = coloursOf(dancer);
  const bar = row.h > 24 ? 4 : row.h > 14 ? 3 : 2;
  if (dancer.speed) {
    drawSpeed(c, dancer, { y: row.y, h: row.h - 2 * bar - 3 }, max, middle, row.h > 24 ? 3.4 : row.h > 14 ? 2.6 : 2);
  }
  if (dancer.figure)
    for (const [side, colour] of [
      [1, left],
      [2, right],
    ]) {
      const bits = dancer.figure.feet.reduce(
        (sum, joint, bit) => sum | (dancer.figure.sides[joint] === side ? 1 << bit : 0),
        0,
      );
      c.fillStyle = colour;
      const y = row.y + row.h - (3 - side) * (bar + 1);
      drawSpans(c, contactSpans(dancer.figure, bits), dancer.figure.rate, y, bar);
    }
  for (const f of dancer.flags)
    if (f[0] !== null) triangle(c, xOf(f[0]), (row.y + 5) * ratio, 4 * ratio, css.flag, null);
}

export function drawPairs(c, clip) {
  if (!clip.pairs.length) return;
  const max = apartMax(clip);
  const many = clip.pairs.length > 1;
  c.globalAlpha = many ? 0.25 : 1;
  for (const pair of clip.pairs) drawCurve(c, { ...pair.distance, max }, rows.apart, css.dim, many ? 1 : 1.6);
  c.globalAlpha = 1;
  if (many) drawCurve(c, { ...clip.pairs[0].distance, values: clip.nearest, max }, rows.apart, css.ink, 1.6);
  if (rows.facing)
    for (const [k, curve] of clip.pairs[0].facing.entries())
      drawCurve(c, { ...curve, max: 180 }, rows.facing, coloursOf(clip.members[clip.pairs[0].of[k]])[0], 1.5);
  for (const pair of clip.pairs) {
    c.fillStyle = css.contact;
    drawSpans(c, pair.contacts, pair.rate, rows.touch.y, rows.touch.h);
    c.fillStyle = css.flag;
    drawSpans(c, pair.collisions, pair.rate, rows.collide.y, rows.collide.h);
  }
}
