// Opening a clip, its music and what it is compared with; the texts about it.
import { play, setLoop } from './clock.js';
import { el, head, loadClip, loadMusic, loadOther, page } from './data.js';
import { flagsNear } from './figure.js';
import { writeLink } from './link.js';
import { showSelected } from './list.js';
import { camera, duration, failed, loopSeconds, plain, state } from './state.js';
import { layOut, redraw, view } from './timeline.js';

// Number of the latest clip that was asked for: one that arrives after a later one is not shown.
let opening = 0;

export async function openItem(item, at = {}) {
  const turn = ++opening;
  const was = state.playing;
  if (was) await play(false);
  const field = at.field || state.field;
  let clip;
  try {
    clip = await loadClip(item.number, field);
  } catch (error) {
    if (turn === opening) failed(error);
    return;
  }
  if (turn !== opening) return;
  Object.assign(state, {
    clip,
    item,
    t: Math.max(0, Math.min(clip.seconds - 1e-6, at.t || 0)),
    loop: null,
    other: null,
    field: field && clip.field,
  });
  el('loop').setAttribute('aria-pressed', false);
  camera.still = true;
  zoomToStart();
  if (at.loop && at.loop[1] > at.loop[0] && at.loop[0] < clip.n) {
    const keep = state.t;
    setLoop([at.loop[0], Math.min(clip.n, at.loop[1])]);
    const l = loopSeconds();
    state.t = Math.max(l[0], Math.min(l[1] - 1e-6, keep));
  }
  showAbout();
  showSelected();
  writeLink();
  const name = at.with || el('with').value;
  await Promise.all([soundOf(clip, turn), name ? compareWith(name).catch(failed) : null]);
  if (was && turn === opening) play(true);
}

function zoomToStart() {
  view.from = 0;
  view.to = duration();
  layOut(state.clip);
  redraw();
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
  state.other = other;
  el('with').value = name || '';
  layOut(clip);
  showAbout();
  redraw();
  writeLink();
}

function showAbout() {
  const clip = state.clip;
  const item = state.item;
  const f = clip.figure;
  el('title').textContent = plain(item.name);
  document.title = `${plain(item.name)} - ${head.name}`;
  el('meta').textContent = [
    clip.split,
    clip.genre && `genre ${clip.genre}`,
    clip.music && `song ${clip.music}`,
    clip.dancer && `dancer ${clip.dancer}`,
    clip.source && `copy of ${clip.source}`,
    f ? `${f.frames} frames at ${round(f.rate)}` : `${clip.n} frames at ${round(clip.fps)}`,
    page.list.windows
      ? `from frame ${clip.start}`
      : clip.windows.length + (clip.windows.length === 1 ? ' window' : ' windows'),
    clip.beats.length && `${clip.beats.length} beats`,
    clip.bpm && `${round(clip.bpm)} BPM`,
    f && `floor at ${(Math.round(f.floor * 100) / 100 || 0).toFixed(2)} m`,
    clip.loading ? 'music is loading' : !clip.wave && clip.beats.length && 'no music: press C to hear the beats',
  ]
    .filter(Boolean)
    .map(plain)
    .join('  ·  ');
  const whole = clip.flags.filter(flag => flag[0] === null).map(flagText);
  el('notes').textContent = [...whole, ...clip.notes, clip.silence, state.other?.note]
    .filter(Boolean)
    .map(plain)
    .join('  ·  ');
  el('flag').disabled = !clip.flagTimes.length;
  el('mirror').disabled = !f;
}

const round = x => String(Math.round(x * 1000) / 1000);
const flagText = f =>
  f[1].replace(/_/g, ' ') +
  (f[2] ? ` ${f[2].replace(/_/g, ' ')}` : '') +
  ' ' +
  round(Math.round(f[3] * 10) / 10) +
  (f[4] === '1' ? ' ×' : ` ${f[4]}`);

export function showNow() {
  const clip = state.clip;
  const near = flagsNear();
  const o = state.other;
  let text = `${state.t.toFixed(2)} / ${duration().toFixed(2)} s · frame ${state.drawn}`;
  if (o?.distance)
    text +=
      ' · ' +
      (o.distance.values[Math.min(o.distance.values.length - 1, Math.round(state.t * o.distance.rate))] || 0).toFixed(
        1,
      ) +
      ' mm from ' +
      plain(o.name) +
      ' (mean ' +
      o.mean.toFixed(1) +
      ')';
  if (el('clock').textContent !== text) el('clock').textContent = text;
  const said = near.slice(0, 2).map(flagText).join(', ') + (near.length > 2 ? ` and ${near.length - 2} more` : '');
  if (el('toast').textContent !== said) el('toast').textContent = plain(said);
  let last = -9;
  for (const beat of clip.beats) if (beat <= state.t + 1e-6) last = beat;
  el('beat').style.opacity = Math.max(0.12, 1 - (state.t - last) * 4);
}
