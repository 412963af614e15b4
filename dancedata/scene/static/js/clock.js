// Time: the clock of the sound, where there is any; else that of the page.
import { el, head, on } from './data.js';
import { writeLink } from './link.js';
import { camera, duration, frameRate, loopSeconds, state } from './state.js';

export let context = null;
export let gain = null;
export let anchor = null;
let source = null;
let clicked = -1;

const sounding = () => context && context.state === 'running';
const clockNow = () => (sounding() ? context.currentTime : performance.now() / 1000);
const latency = () => (sounding() ? context.outputLatency || 0 : 0);

async function wakeSound() {
  if (!context && window.AudioContext) {
    context = new AudioContext();
    gain = context.createGain();
    gain.connect(context.destination);
  }
  if (context && context.state !== 'running')
    await Promise.race([context.resume(), new Promise(r => setTimeout(r, 400))]);
  setGain();
}

export function setGain() {
  if (gain) gain.gain.value = state.mute ? 0 : state.volume;
}

// Position at an instant of the clock; in a loop it comes round.
function positionAt(instant) {
  let x = anchor.t + Math.max(0, instant - anchor.at) * anchor.rate;
  const loop = loopSeconds();
  if (loop && x >= loop[1]) x = loop[0] + ((x - loop[0]) % (loop[1] - loop[0]));
  return x;
}

function stopSource() {
  if (source) {
    source.onended = null;
    try {
      source.stop();
    } catch (_e) {
      /* not started */
    }
    source.disconnect();
    source = null;
  }
}

// Starts the music and the picture at one instant; called again after every jump and change of speed. The instant lies
// ahead: music that is asked to start in the past starts late, and would stay late.
const LEAD = 0.1;

export function restart() {
  stopSource();
  anchor = { at: clockNow() + (sounding() ? LEAD : 0), t: state.t, rate: state.rate };
  clicked = -1;
  const music = state.clip.sound;
  if (!sounding() || !music) return;
  source = context.createBufferSource();
  source.buffer = music;
  source.playbackRate.value = state.rate;
  const loop = loopSeconds();
  if (loop) {
    source.loop = true;
    source.loopStart = loop[0];
    source.loopEnd = loop[1];
  }
  source.connect(gain);
  source.start(anchor.at, Math.min(state.t, music.duration));
}

// Plays without sound, as pages may that nobody has touched; with it from the first click or key on.
export function playSilently() {
  state.playing = true;
  showPlaying();
  restart();
  el('sound').hidden = !head.sound;
  const wake = async () => {
    el('sound').hidden = true;
    if (context || !state.playing) return;
    await wakeSound();
    if (state.playing) restart();
  };
  for (const kind of ['pointerdown', 'keydown']) on(window, kind, wake, { once: true, capture: true });
}

export async function play(on) {
  if (!state.clip || on === state.playing) return;
  state.playing = on;
  showPlaying();
  if (!on) {
    stopSource();
    writeLink();
    return;
  }
  await wakeSound();
  if (!state.playing) return;
  const loop = loopSeconds();
  if (state.t >= duration() - 0.5 / frameRate()) state.t = loop ? loop[0] : 0;
  restart();
}

export function seek(x) {
  if (!state.clip) return;
  const last = Math.max(0, duration() - 1 / frameRate());
  state.t = Math.max(0, Math.min(last, x));
  const loop = loopSeconds();
  if (loop && (state.t < loop[0] - 1e-6 || state.t >= loop[1])) setLoop(null);
  if (state.playing) restart();
  state.dirty = true;
  writeLink();
}

// A loop is in frames of the dataset, as in links: [first, end).
export function setLoop(frames) {
  state.loop = frames;
  el('loop').ariaPressed = !!frames;
  const loop = loopSeconds();
  if (loop && (state.t < loop[0] || state.t >= loop[1])) state.t = loop[0];
  if (state.playing) restart();
  state.dirty = true;
  writeLink();
}

export function advance() {
  if (!state.playing || !anchor) return;
  const x = positionAt(clockNow() - latency());
  if (!state.loop && x >= duration()) {
    state.t = Math.max(0, duration() - 1 / frameRate());
    play(false);
  } else state.t = x;
  state.dirty = true;
}

// The metronome looks ahead, so that a busy page does not delay a click.
export function metronome() {
  if (!state.playing || !state.click || !sounding() || !anchor) return;
  const now = context.currentTime;
  const x = positionAt(now);
  const loop = loopSeconds();
  for (const beat of state.clip.beats) {
    if (loop && (beat < loop[0] || beat >= loop[1])) continue;
    let ahead = (beat - x) / state.rate;
    if (ahead < 0 && loop) ahead += (loop[1] - loop[0]) / state.rate;
    const at = now + ahead;
    if (ahead < 0 || ahead > 0.15 || at <= clicked + 0.02) continue;
    clicked = at;
    const tone = context.createOscillator();
    const loud = context.createGain();
    tone.frequency.value = 1600;
    loud.gain.setValueAtTime(0.35, at);
    loud.gain.exponentialRampToValueAtTime(0.001, at + 0.05);
    tone.connect(loud).connect(context.destination);
    tone.start(at);
    tone.stop(at + 0.06);
  }
}

const PLAY = 'M3 1.5v13L14 8z';
const PAUSE = 'M3 2h4v12H3zM9 2h4v12H9z';

function showPlaying() {
  el('play')
    .querySelector('path')
    .setAttribute('d', state.playing ? PAUSE : PLAY);
  el('play').ariaLabel = state.playing ? 'Pause' : 'Play';
  camera.still = true;
}
