// The dancers of a group: which are drawn, their colours, and what they are called.
import { page } from './data.js';
import { state } from './state.js';

// The dancers that are drawn together; null for a clip, and for one dancer of a group alone.
export const together = () => (state.clip?.members && state.dancer === null ? state.clip.members : null);

// Trunk, left limbs, right limbs. By the number in the source, which stays where others are left out.
export function coloursOf(dancer) {
  const palette = page.list.palette[document.documentElement.dataset.theme];
  return palette[Math.max(0, dancer.member) % palette.length];
}

// The two dancers who are nearest to each other at a time, and how far they are apart.
export function nearestAt(clip, t) {
  let found = null;
  for (const pair of clip.pairs) {
    const frame = Math.max(0, Math.min(pair.distance.values.length - 1, Math.round(t * pair.rate)));
    const metres = pair.distance.values[frame];
    if (!found || metres < found.metres) found = { pair, metres, frame };
  }
  return found;
}

// Contacts between dancers at a time: [pair, contact].
export const touching = (clip, t) =>
  clip.pairs.flatMap(pair =>
    pair.contacts
      .filter(([start, end]) => start <= t * pair.rate + 1e-4 && t * pair.rate < end - 1e-4)
      .map(contact => [pair, contact]),
  );

export const collidesAt = (pair, t) =>
  pair.collisions.some(([start, end]) => start <= t * pair.rate + 1e-4 && t * pair.rate < end - 1e-4);

// The comparison with what is drawn: of a group, or of the dancer who is shown alone.
export const otherOf = compared =>
  compared?.members && state.dancer !== null ? { ...compared.members[state.dancer], name: compared.name } : compared;

// Makes a clip of a group that of one of its dancers, or of all (null).
export function chooseOf(clip, k) {
  state.dancer = k;
  const one = k === null ? null : clip.members[k];
  const flags = clip.members.flatMap((m, at) => m.flags.map(f => [...f, at]));
  Object.assign(clip, {
    figure: (one || clip.members.find(m => m.figure) || clip.members[0]).figure,
    speed: one ? one.speed : null,
    keys: one ? one.keys : null,
    offsets: one ? one.offsets : null,
    flags: one ? one.flags : flags,
  });
  clip.flagTimes = [...new Set(clip.flags.map(f => f[0]).filter(t => t !== null))].sort((a, b) => a - b);
}
