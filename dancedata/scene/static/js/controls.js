// Buttons, keys, themes and the camera.
import { lanes, moveBy, zoomAround } from './axis.js';
import { fullScreen, lookFrom, startCamera, turn } from './camera.js';
import { chooseDancer, compareWith, nextDancer, openItem, readySkin, setBody, showAbout } from './clip.js';
import { advance, play, restart, seek, setGain, setLoop } from './clock.js';
import { dancerAt } from './crowd.js';
import { together } from './dancers.js';
import { el, head, make, on, option } from './data.js';
import { canvas, ratio, readColours } from './figure.js';
import { canSkin } from './gl.js';
import { linkNow, writeLink } from './link.js';
import { step } from './list.js';
import { noteNow, rejectNow, saveMarks, starNow } from './marks.js';
import { camera, duration, failed, frameRate, SKIN, state } from './state.js';
import { loopAt, redraw } from './timeline.js';

export function setTheme(name, chosen) {
  document.documentElement.dataset.theme = name === 'light' ? 'light' : 'dark';
  state.themeChosen = state.themeChosen || chosen;
  readColours();
  if (state.clip?.members) showAbout(); // its colours go with the theme
  redraw();
}

export function setMode(name, on) {
  state[name] = on;
  el(name).ariaPressed = on;
  state.dirty = true;
}

const toggle = name => () => {
  setMode(name, !state[name]);
  camera.still = true;
  writeLink();
};

// Skin, limbs, sticks, and again; without the skin where it cannot be drawn fast.
function nextBody() {
  setBody(state.body ? state.body - 1 : canSkin(false) ? SKIN : 1, true);
  camera.still = true;
  readySkin().catch(failed);
  writeLink();
}

function nextFlag(back) {
  const times = state.clip.flagTimes;
  const now = state.t;
  const next = back
    ? (times.findLast(t => t < now - 1e-4) ?? times[times.length - 1])
    : (times.find(t => t > now + 1e-4) ?? times[0]);
  if (next !== undefined) seek(next);
}

function nextBeat(back) {
  const found = back
    ? state.clip.beats.findLast(b => b < state.t - 0.01)
    : state.clip.beats.find(b => b > state.t + 0.01);
  if (found !== undefined) seek(found);
}

const nextFrame = by => seek((Math.round(state.t * frameRate()) + by) / frameRate());

function setRate(value) {
  state.rate = value;
  el('rate').value = String(value);
  if (state.playing) {
    advance();
    restart();
  }
}

function showKeys() {
  el('keys').showModal();
  el('keys').scrollTop = 0; // the focus is on the button at the end
}

function mirrorKey() {
  if (together()) el('toast').textContent = 'choose a dancer to see the mirrored copy';
  else el('mirror').click();
}

const RATES = { 1: 0.25, 2: 0.5, 3: 1, 4: 1.5, 5: 2 };
const KEYS = [
  [' ', 'space', 'play or pause', () => play(!state.playing)],
  ['ArrowLeft', '←', 'one frame back; with shift one beat', e => (e.shiftKey ? nextBeat(true) : nextFrame(-1))],
  ['ArrowRight', '→', 'one frame on; with shift one beat', e => (e.shiftKey ? nextBeat(false) : nextFrame(1))],
  ['Home', 'Home', 'to the beginning', () => seek(0)],
  ['End', 'End', 'to the end', () => seek(duration())],
  ['[', '[', 'previous clip', () => step(-1)],
  [']', ']', 'next clip', () => step(1)],
  ['l', 'L', 'loop the window under the cursor', () => el('loop').click()],
  ['m', 'M', 'mirrored copy', mirrorKey],
  ['b', 'B', 'skin, limbs or sticks', () => el('body').click()],
  ['o', 'O', 'overlay, or side by side', () => el('over').click()],
  ['c', 'C', 'metronome', () => el('click').click()],
  ['u', 'U', 'mute the music', () => el('mute').click()],
  ...(head.groups
    ? [
        ['d', 'D', 'next dancer of the group alone; with shift the one before', e => nextDancer(e.shiftKey ? -1 : 1)],
        ['g', 'G', 'the whole group', () => chooseDancer(null)],
      ]
    : []),
  ['r', 'R', 'camera as at the beginning; a double click on the stage, too', () => lookFrom('reset')],
  ...['front', 'left', 'back', 'top'].map((name, k) => [
    `F${k + 1}`,
    `F${k + 1}`,
    name === 'top' ? 'from the top' : name === 'left' ? "from the dancer's left" : `from the ${name}`,
    () => lookFrom(name),
  ]),
  ['a', 'A', 'turn the camera to the left', () => turn(-0.15, 0)],
  ['e', 'E', 'turn it to the right', () => turn(0.15, 0)],
  ['w', 'W', 'turn it up', () => turn(0, 0.1)],
  ['s', 'S', 'turn it down', () => turn(0, -0.1)],
  ['t', 'T', 'camera follows the dancer, or stays', () => el('follow').click()],
  ['z', 'Z', 'full screen', fullScreen],
  ['k', 'K', 'star this moment', starNow],
  ['x', 'X', 'reject the clip', rejectNow],
  ['n', 'N', 'note at this moment', noteNow],
  ['f', 'F', 'next quality flag; with shift the one before', e => nextFlag(e.shiftKey)],
  ...Object.keys(RATES).map(k => [k, k, `${RATES[k]} times the speed`, () => setRate(RATES[k])]),
  ['+', '+', 'zoom the time axis in', () => zoomAround(state.t, 0.7)],
  ['-', '-', 'zoom it out', () => zoomAround(state.t, 1 / 0.7)],
  [',', ',', 'move the zoomed time axis back', () => moveBy(-0.5)],
  ['.', '.', 'move it on', () => moveBy(0.5)],
  [
    '/',
    '/',
    'filter clips',
    () => {
      el('picker').classList.add('open');
      el('q').focus();
    },
  ],
  ['?', '?', 'this table', showKeys],
];

export function onKey(e) {
  if (e.ctrlKey || e.metaKey || e.altKey || el('keys').open) return;
  if (e.target.matches?.('input,select,textarea')) {
    if (e.key === 'Escape') e.target.blur();
    else if (!e.target.matches('[type=checkbox]') || e.key === ' ') return;
  }
  if (e.target.matches?.('button,summary,a') && (e.key === ' ' || e.key === 'Enter')) return;
  const key = e.key.length === 1 ? e.key.toLowerCase() : e.key;
  const found = KEYS.find(k => k[0] === key);
  if (found && state.clip) {
    e.preventDefault();
    found[3](e);
  }
}

export function startControls() {
  const click = (name, action) =>
    on(el(name), 'click', e => {
      action(e);
      if (e.detail) el(name).blur();
    });
  click('play', () => play(!state.playing));
  click('prev', () => step(-1));
  click('next', () => step(1));
  click('loop', () => {
    if (state.loop) setLoop(null);
    else if (!loopAt(state.t)) setLoop([0, state.clip.n]);
  });
  click('mirror', toggle('mirror'));
  click('over', toggle('over'));
  click('body', nextBody);
  click('click', toggle('click'));
  click('mute', () => {
    setMode('mute', !state.mute);
    setGain();
  });
  click('flag', () => nextFlag(false));
  click('help', showKeys);
  click('theme', () => {
    setTheme(document.documentElement.dataset.theme === 'light' ? 'dark' : 'light', true);
    writeLink();
  });
  click('link', copyLink);
  on(el('rate'), 'change', () => {
    setRate(+el('rate').value);
    el('rate').blur();
  });
  on(el('with'), 'change', () => {
    compareWith(el('with').value).catch(failed);
    el('with').blur();
  });
  on(el('field'), 'change', () => {
    const t = state.t;
    const loop = state.loop;
    openItem(state.item, { t, loop, field: el('field').value, dancer: state.dancer });
    el('field').blur();
  });
  el('field').replaceChildren(...head.fields.map(option));
  el('field').hidden = head.fields.length < 2;
  for (const [, label, what] of KEYS) {
    const row = el('keytable').insertRow();
    row.insertCell().append(make('kbd', label));
    row.insertCell().textContent = what;
  }
  click('zoomin', () => zoomAround(state.t, 0.5));
  click('zoomout', () => zoomAround(state.t, 2));
  click('full', fullScreen);
  click('marks', saveMarks);
  click('follow', toggle('follow'));
  on(el('volume'), 'input', () => {
    setMode('mute', false);
    state.volume = +el('volume').value;
    setGain();
  });
  on(el('volume'), 'change', () => el('volume').blur());
  on(lanes, 'dancer', e => chooseDancer(e.detail));
  startCamera(e => {
    if (!together()) return;
    const box = canvas.getBoundingClientRect();
    const k = dancerAt((e.clientX - box.left) * ratio, (e.clientY - box.top) * ratio);
    if (k !== null) chooseDancer(k);
  });
}

async function copyLink() {
  const address = location.href.split('#')[0] + linkNow();
  try {
    await navigator.clipboard.writeText(address);
    el('link').textContent = 'Copied';
  } catch (_e) {
    prompt('Link', address);
  }
  setTimeout(() => {
    el('link').textContent = 'Copy link';
  }, 1200);
}
