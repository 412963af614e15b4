// Opening a clip, its music and what it is compared with; the texts about it.
import { view } from './axis.js';
import { play, setLoop } from './clock.js';
import { chooseOf, collidesAt, coloursOf, nearestAt, otherOf, together, touching } from './dancers.js';
import {
  el,
  head,
  items,
  loadClip,
  loadMusic,
  loadOther,
  loadRest,
  loadTurns,
  make,
  on,
  option,
  page,
  plain,
  root,
} from './data.js';
import { flagsNear } from './figure.js';
import { canSkin } from './gl.js';
import { enableControls, fitControls } from './layout.js';
import { flushLink, writeLink } from './link.js';
import { showSelected } from './list.js';
import { camera, duration, failed, loopSeconds, SKIN, state } from './state.js';
import { hitsOf, layOut, redraw } from './timeline.js';
import { wordsAt } from './words.js';

// Number of the latest clip that was asked for: one that arrives after a later one is not shown.
let opening = 0;

export async function openItem(item, at = {}) {
  const turn = ++opening;
  const was = state.playing;
  if (was) await play(false);
  const field = at.field || state.field;
  const said = setTimeout(() => {
    if (turn === opening) el('notes').textContent = `loading ${plain(item.name)}…`;
  }, 200);
  let clip;
  try {
    clip = await loadClip(item.number, field);
  } catch (error) {
    if (turn === opening) failed(error);
    return;
  } finally {
    clearTimeout(said);
  }
  if (turn !== opening) return;
  enableControls(true);
  root.classList.remove('ended');
  // "Back" returns to the clip before, at its time; a link that is followed is in the history already.
  const another = state.item && state.item !== item && !at.linked;
  if (another) flushLink();
  Object.assign(state, {
    clip,
    item,
    t: Math.max(0, Math.min(clip.seconds - 1e-6, at.t || 0)),
    loop: null,
    other: null,
    compared: null,
    hovered: null,
    field: field && clip.field,
    dancer: null,
  });
  if (clip.members) chooseOf(clip, at.dancer ?? null);
  el('loop').ariaPressed = false;
  camera.still = true;
  camera.placed = false;
  zoomToStart();
  if (at.loop && at.loop[1] > at.loop[0] && at.loop[0] < clip.n) {
    const keep = state.t;
    setLoop([at.loop[0], Math.min(clip.n, at.loop[1])]);
    const l = loopSeconds();
    state.t = Math.max(l[0], Math.min(l[1] - 1e-6, keep));
  }
  const name = at.with || (head.takes.includes(el('with').value) ? el('with').value : '');
  showTakes();
  showAbout();
  showSelected();
  writeLink(another);
  if (clip.partial) restOf(clip, field, turn).catch(failed);
  else readySkin().catch(failed);
  await Promise.all([soundOf(clip, turn), name ? compareWith(name).catch(failed) : null]);
  if (was && turn === opening) play(true);
}

// What this clip can be compared with; among other clips, those of its song come first.
function showTakes() {
  const { item } = state;
  const others = page.server && !head.wall && !item.members ? items.filter(i => i !== item && !i.members) : [];
  const beside = make('optgroup');
  beside.label = 'another clip';
  others.sort((a, b) => (b.music === item.music) - (a.music === item.music));
  beside.append(...others.slice(0, 60).map(i => option(i.name)));
  el('with').replaceChildren(new Option('compare with…', ''), ...head.takes.map(option), beside);
  el('with').hidden = el('over').hidden = !head.takes.length && !others.length;
  fitControls();
}

function zoomToStart() {
  view.from = 0;
  view.to = duration();
  layOut(state.clip);
  redraw();
}

async function restOf(clip, field, turn) {
  await loadRest(clip, field);
  if (turn !== opening) return;
  readySkin().catch(failed);
  if (clip.members) chooseOf(clip, state.dancer);
  layOut(clip);
  showAbout();
  redraw();
}

// How bodies are drawn; `chosen` by key or link, or null for the best that this machine draws fast.
export function setBody(level, chosen) {
  state.body = level;
  state.bodyChosen = chosen;
  const name = ['Sticks', 'Limbs', 'Skin'][level];
  el('body').textContent = name;
  el('body').ariaLabel = `Body: ${name}`;
  state.dirty = true;
}

// Fetches what a skin needs, after the clip is seen; limbs where skins cannot be drawn.
export async function readySkin() {
  const { clip, compared } = state;
  if (state.body !== SKIN || clip.partial) return;
  if (!canSkin(state.bodyChosen)) return setBody(1, state.bodyChosen);
  await loadTurns(clip, compared, state.field);
  state.dirty = true;
}

async function soundOf(clip, turn) {
  const made = loadMusic(clip);
  clip.loading = page.server && head.sound && !clip.wave;
  if (clip.loading) showAbout();
  try {
    await made;
  } catch (_error) {
    clip.silence = 'the music cannot be decoded';
  }
  clip.loading = false;
  if (turn !== opening) return;
  layOut(clip);
  showAbout();
  redraw();
}

export async function compareWith(name) {
  const clip = state.clip;
  const other = name ? await loadOther(clip, name) : null;
  if (state.clip !== clip) return;
  state.compared = other;
  state.other = otherOf(other);
  readySkin().catch(failed);
  const box = el('with');
  box.value = name || '';
  // One from a link that is not listed.
  if (name && !box.value) box.add(new Option(plain(name), name, true, true));
  layOut(clip);
  showAbout();
  redraw();
  writeLink();
}

// Shows one dancer of a group alone, or all of them (null).
export function chooseDancer(k) {
  const clip = state.clip;
  if (!clip?.members || k === state.dancer) return;
  chooseOf(clip, k);
  state.other = otherOf(state.compared);
  camera.still = true;
  layOut(clip);
  showAbout();
  redraw();
  writeLink();
}

export function nextDancer(by) {
  const n = state.clip.members?.length;
  if (!n) return;
  const k = (state.dancer === null ? (by > 0 ? 0 : n - 1) : state.dancer + by + n + 1) % (n + 1);
  chooseDancer(k === n ? null : k);
}

// One button for the group and one for each dancer.
function showDancers() {
  const box = el('dancers');
  const members = state.clip.members;
  box.hidden = !members;
  root.classList.toggle('crowd', !!together());
  if (!members) return;
  const button = (text, k, tones) => {
    const found = make('button');
    found.ariaPressed = state.dancer === k;
    for (const tone of tones) {
      const mark = make('i');
      mark.style.background = tone;
      found.append(mark);
    }
    found.append(text, ...numbersOf(k === null ? null : members[k]));
    found.title = k === null ? 'The whole group  ( G )' : found.lastChild.textContent;
    on(found, 'click', e => {
      chooseDancer(k);
      if (e.detail) document.activeElement?.blur();
    });
    return found;
  };
  box.replaceChildren(button('all', null, []), ...members.map((m, k) => button(m.called, k, coloursOf(m).slice(1))));
}

// What is measured of a dancer of a wall.
function numbersOf(member) {
  if (!member?.numbers) return [];
  return [make('small', member.numbers.map(pair => pair.join(' ')).join(' · '))];
}

export function showAbout() {
  const clip = state.clip;
  const item = state.item;
  const f = clip.figure;
  const one = clip.members && state.dancer !== null ? clip.members[state.dancer] : null;
  const name = one ? one.clip : item.name;
  showDancers();
  el('title').textContent = plain(name);
  document.title = `${plain(name)} - ${head.name}`;
  el('meta').textContent = [
    clip.split,
    clip.members &&
      (one
        ? `dancer ${one.part}, of ${clip.members.length}`
        : `${clip.members.length} dancer${clip.members.length > 1 ? 's' : ''}`),
    clip.genre && `genre ${clip.genre}`,
    clip.music && `song ${clip.music}`,
    clip.dancer && `dancer ${clip.dancer}`,
    clip.source && `copy of ${clip.source}`,
    f ? `${f.frames} frames at ${round(f.rate)}` : `${clip.n} frames at ${round(clip.fps)}`,
    page.list.windows
      ? `from frame ${clip.start}`
      : clip.windows.length + (clip.windows.length === 1 ? ' window' : ' windows'),
    clip.beats.length && !(clip.offsets && !together()) && `${clip.beats.length} beats`,
    clip.offsets && !together() && hitsOf(clip.offsets),
    clip.bpm && `${round(clip.bpm)} BPM`,
    clip.partial && 'first minute; the rest is loading',
    !clip.loading && !clip.wave && clip.beats.length && 'no music: press C to hear the beats',
  ]
    .filter(Boolean)
    .map(plain)
    .join('  ·  ');
  const floor = f && !together() ? `  ·  floor at ${metres(f.floor)} m, feet from ${metres(f.lowest)} m` : '';
  el('meta').title = el('meta').textContent + floor;
  const whole = clip.flags.filter(flag => flag[0] === null).map(flagText);
  el('notes').textContent = [...whole, ...clip.notes, clip.silence, state.other?.note]
    .filter(Boolean)
    .map(plain)
    .join('  ·  ');
  el('flag').disabled = !clip.flagTimes.length;
  el('mirror').disabled = !f || !!together();
  el('mirror').title = together() ? 'Choose a dancer to see the mirrored copy' : 'Mirrored copy  (M)';
}

const metres = x => (Math.round(x * 100) / 100 || 0).toFixed(2);
const round = x => String(Math.round(x * 1000) / 1000);
const flagText = f =>
  f[1].replace(/_/g, ' ') +
  (f[2] ? ` ${f[2].replace(/_/g, ' ')}` : '') +
  ' ' +
  round(Math.round(f[3] * 10) / 10) +
  (f[4] === '1' ? ' ×' : ` ${f[4]}`);

// The nearest two dancers, what touches, and who collides, in words.
function groupNow(clip) {
  const near = nearestAt(clip, state.t);
  if (!near) return '';
  const called = k => clip.members[k].called;
  const names = pair => pair.of.map(called).join(' and ');
  let text = ` · ${names(near.pair)} ${near.metres.toFixed(2)} m apart`;
  if (clip.pairs.length === 1)
    text += ` · facing ${near.pair.facing.map(curve => `${Math.round(curve.values[near.frame])}°`).join(' and ')}`;
  const [found] = touching(clip, state.t);
  if (found) {
    const [pair, contact] = found;
    const joint = place => clip.members[pair.of[place]].figure.joints[contact[2 + place]].replace(/_/g, ' ');
    text += ` · ${called(pair.of[0])} ${joint(0)} at ${called(pair.of[1])} ${joint(1)}`;
  }
  const hit = clip.pairs.find(pair => collidesAt(pair, state.t));
  return hit ? `${text} · ${names(hit)} collide` : text;
}

export function showNow() {
  const clip = state.clip;
  const near = flagsNear();
  const o = state.other;
  let text = `${state.t.toFixed(2)} / ${duration().toFixed(2)} s · frame ${state.drawn}`;
  if (o?.distance) {
    const { values, rate } = o.distance;
    const at = state.t * rate;
    const now = values[Math.min(values.length - 1, Math.round(at))];
    const from = at > values.length ? `${plain(o.name)} has ended` : `${now.toFixed(1)} mm from ${plain(o.name)}`;
    text += ` · ${from} (mean ${o.mean.toFixed(1)})`;
  }
  if (clip.loading) text += ' · music is loading';
  if (together()) text += groupNow(clip);
  for (const words of wordsAt(clip, state.t)) text += ` · ${words.length > 90 ? `${words.slice(0, 88)}…` : words}`;
  if (el('clock').textContent !== text) el('clock').textContent = text;
  const whose = f => (together() ? `${clip.members[f[5]].called}: ` : '') + flagText(f);
  const w = state.hovered;
  const hovered = w && `window ${clip.windows.indexOf(w)}: frames ${w[0]} to ${w[0] + w[1] - 1}`;
  const said =
    hovered || near.slice(0, 2).map(whose).join(', ') + (near.length > 2 ? ` and ${near.length - 2} more` : '');
  if (el('toast').textContent !== said) el('toast').textContent = plain(said);
  let last = -9;
  for (const beat of clip.beats) if (beat <= state.t + 1e-6) last = beat;
  el('beat').style.opacity = Math.max(0.12, 1 - (state.t - last) * 4);
}
