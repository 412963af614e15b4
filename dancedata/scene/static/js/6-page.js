// The page: opening clips, buttons, keys, links.
const wholePage = document.documentElement.classList.contains('dd-page');
let opening = 0, linkTimer = 0;

const PLAY = 'M3 1.5v13L14 8z', PAUSE = 'M3 2h4v12H3zM9 2h4v12H9z';
function showPlaying() {
  el('play').querySelector('path').setAttribute('d', state.playing ? PAUSE : PLAY);
  el('play').setAttribute('aria-label', state.playing ? 'Pause' : 'Play');
  camera.still = true;
}

function failed(error) {
  const gone = /rebuilt/.test(error.message);
  el('notes').textContent = gone ? 'The dataset was built again: start dancedata view again.' : plain(String(error.message || error));
}

async function openItem(item, at = {}) {
  const turn = ++opening, was = state.playing;
  if (was) await play(false);
  const field = at.field || state.field;
  let clip;
  try { clip = await loadClip(item.number, field); } catch (error) { if (turn === opening) failed(error); return; }
  if (turn !== opening) return;
  Object.assign(state, { clip, item, t: Math.max(0, Math.min(clip.seconds - 1e-6, at.t || 0)), loop: null, other: null, field: field && clip.field });
  el('loop').setAttribute('aria-pressed', false);
  camera.still = true;
  zoomToStart();
  if (at.loop && at.loop[1] > at.loop[0] && at.loop[0] < clip.n) { const keep = state.t; setLoop([at.loop[0], Math.min(clip.n, at.loop[1])]); const l = loopSeconds(); state.t = Math.max(l[0], Math.min(l[1] - 1e-6, keep)); }
  showAbout();
  showSelected();
  writeLink();
  const name = at.with || el('with').value;
  await Promise.all([soundOf(clip, turn), name ? compareWith(name).catch(failed) : null]);
  if (was && turn === opening) play(true);
}

function zoomToStart() { view.from = 0; view.to = duration(); layOut(state.clip); base = null; state.dirty = true; }

async function soundOf(clip, turn) {
  const made = loadMusic(clip);
  clip.loading = page.server && head.sound && !clip.wave;
  if (clip.loading) showAbout();
  try { await made; } catch (error) { clip.silence = 'the music cannot be decoded'; }
  clip.loading = false;
  if (turn !== opening) return;
  layOut(clip); showAbout();
  base = null; state.dirty = true;
}

async function compareWith(name) {
  const clip = state.clip, other = name ? await loadOther(clip, name) : null;
  if (state.clip !== clip) return;
  state.other = other;
  el('with').value = name || '';
  layOut(clip); showAbout();
  base = null; state.dirty = true;
  writeLink();
}

function showAbout() {
  const clip = state.clip, item = state.item, f = clip.figure;
  el('title').textContent = plain(item.name);
  document.title = plain(item.name) + ' - ' + head.name;
  el('meta').textContent = [clip.split, clip.genre && 'genre ' + clip.genre, clip.music && 'song ' + clip.music, clip.dancer && 'dancer ' + clip.dancer,
    clip.source && 'copy of ' + clip.source, f ? f.frames + ' frames at ' + round(f.rate) : clip.n + ' frames at ' + round(clip.fps),
    page.list.windows ? 'from frame ' + clip.start : clip.windows.length + (clip.windows.length === 1 ? ' window' : ' windows'),
    clip.beats.length && clip.beats.length + ' beats', clip.bpm && round(clip.bpm) + ' BPM', f && 'floor at ' + (Math.round(f.floor * 100) / 100 || 0).toFixed(2) + ' m',
    clip.loading ? 'music is loading' : !clip.wave && clip.beats.length && 'no music: press C to hear the beats'].filter(Boolean).map(plain).join('  ·  ');
  const whole = clip.flags.filter(flag => flag[0] === null).map(flagText);
  el('notes').textContent = [...whole, ...clip.notes, clip.silence, state.other && state.other.note].filter(Boolean).map(plain).join('  ·  ');
  el('flag').disabled = !clip.flagTimes.length;
  el('mirror').disabled = !f;
}

const round = x => String(Math.round(x * 1000) / 1000);
const flagText = f => f[1].replace(/_/g, ' ') + (f[2] ? ' ' + f[2].replace(/_/g, ' ') : '') + ' ' + round(Math.round(f[3] * 10) / 10) + (f[4] === '1' ? ' ×' : ' ' + f[4]);

function showNow() {
  const clip = state.clip, near = flagsNear(), o = state.other;
  let text = state.t.toFixed(2) + ' / ' + duration().toFixed(2) + ' s · frame ' + state.drawn;
  if (o && o.distance) text += ' · ' + (o.distance.values[Math.min(o.distance.values.length - 1, Math.round(state.t * o.distance.rate))] || 0).toFixed(1) + ' mm from ' + plain(o.name) + ' (mean ' + o.mean.toFixed(1) + ')';
  if (el('clock').textContent !== text) el('clock').textContent = text;
  const said = near.slice(0, 2).map(flagText).join(', ') + (near.length > 2 ? ' and ' + (near.length - 2) + ' more' : '');
  if (el('toast').textContent !== said) el('toast').textContent = plain(said);
  let last = -9;
  for (const beat of clip.beats) if (beat <= state.t + 1e-6) last = beat;
  el('beat').style.opacity = Math.max(0.12, 1 - (state.t - last) * 4);
}

// Links: #clip=ID&t=5.800&loop=90-240
function linkNow() {
  const parts = ['clip=' + encodeURIComponent(state.item.id)];
  if (page.list.windows) parts.push('window=' + state.item.start);
  parts.push('t=' + state.t.toFixed(3));
  if (state.loop) parts.push('loop=' + state.loop.join('-'));
  if (state.field) parts.push('field=' + encodeURIComponent(state.field));
  if (state.other) parts.push('with=' + encodeURIComponent(state.other.name));
  if (state.mirror) parts.push('mirror=1');
  if (state.over) parts.push('over=1');
  if (themeChosen) parts.push('theme=' + document.documentElement.dataset.theme);
  return '#' + parts.join('&');
}

function writeLink() {
  clearTimeout(linkTimer);
  const before = location.hash;
  // Not over a link that was opened meanwhile and is still to be followed.
  if (wholePage) linkTimer = setTimeout(() => { try { if (location.hash === before) history.replaceState(null, '', linkNow()); } catch (e) { /* a page inside another one has no address */ } }, 120);
}

// Not URLSearchParams: it reads a plus sign as a space.
function readLink() {
  const found = {};
  for (const part of location.hash.slice(1).split('&')) {
    const [key, value = ''] = part.split(/=(.*)/s);
    try { found[key] = decodeURIComponent(value); } catch (e) { found[key] = value; }
  }
  return found;
}

async function followLink() {
  const h = readLink(), mine = items.filter(i => i.id === h.clip), loop = (h.loop || '').match(/^(\d+)-(\d+)$/);
  if (h.theme) setTheme(h.theme, true);
  const item = mine.find(i => !h.window || i.start === +h.window) || mine[0] || shown[0] || items[0];
  if (!item) return;
  setMode('mirror', h.mirror === '1'); setMode('over', h.over === '1');
  const known = mine.length || !h.clip ? { t: +h.t || 0, loop: loop && [+loop[1], +loop[2]], field: head.fields.includes(h.field) ? h.field : '', with: head.takes.includes(h.with) ? h.with : '' } : {};
  await openItem(item, known);
  if (h.clip && !mine.length) el('notes').textContent = 'This dataset has no clip ' + plain(h.clip);
}

let themeChosen = false;
function setTheme(name, chosen) {
  document.documentElement.dataset.theme = name === 'light' ? 'light' : 'dark';
  themeChosen = themeChosen || chosen;
  readColours();
  base = null; state.dirty = true;
}

function setMode(name, on) { state[name] = on; el(name).setAttribute('aria-pressed', on); state.dirty = true; }
const toggle = name => () => { setMode(name, !state[name]); camera.still = true; writeLink(); };

function nextFlag(back) {
  const times = state.clip.flagTimes, now = state.t;
  const next = back ? times.findLast(t => t < now - 1e-4) ?? times[times.length - 1] : times.find(t => t > now + 1e-4) ?? times[0];
  if (next !== undefined) seek(next);
}

function nextBeat(back) {
  const found = back ? state.clip.beats.findLast(b => b < state.t - 0.01) : state.clip.beats.find(b => b > state.t + 0.01);
  if (found !== undefined) seek(found);
}

const nextFrame = by => seek((Math.round(state.t * frameRate()) + by) / frameRate());
function setRate(value) { state.rate = value; el('rate').value = String(value); if (state.playing) { advance(); restart(); } }

const RATES = { 1: 0.25, 2: 0.5, 3: 1, 4: 1.5, 5: 2 };
const KEYS = [
  [' ', 'space', 'play or pause', () => play(!state.playing)], ['ArrowLeft', '←', 'one frame back; with shift one beat', e => e.shiftKey ? nextBeat(true) : nextFrame(-1)],
  ['ArrowRight', '→', 'one frame on; with shift one beat', e => e.shiftKey ? nextBeat(false) : nextFrame(1)], ['Home', 'Home', 'to the beginning', () => seek(0)], ['End', 'End', 'to the end', () => seek(duration())],
  ['[', '[', 'previous clip', () => step(-1)], [']', ']', 'next clip', () => step(1)], ['l', 'L', 'loop the window under the cursor', () => el('loop').click()],
  ['m', 'M', 'mirrored copy', () => el('mirror').click()], ['o', 'O', 'overlay, or side by side', () => el('over').click()], ['c', 'C', 'metronome', () => el('click').click()], ['u', 'U', 'mute the music', () => el('mute').click()],
  ['f', 'F', 'next quality flag; with shift the one before', e => nextFlag(e.shiftKey)], ...Object.keys(RATES).map(k => [k, k, RATES[k] + ' times the speed', () => setRate(RATES[k])]),
  ['+', '+', 'zoom the time axis in', () => zoomAround(state.t, 0.7)], ['-', '-', 'zoom it out', () => zoomAround(state.t, 1 / 0.7)], ['/', '/', 'filter clips', () => { el('picker').classList.add('open'); el('q').focus(); }],
  ['?', '?', 'this table', () => el('keys').showModal()],
];

function onKey(e) {
  if (e.ctrlKey || e.metaKey || e.altKey || el('keys').open) return;
  if (e.target.matches && e.target.matches('input,select,textarea')) { if (e.key === 'Escape') e.target.blur(); else if (!e.target.matches('[type=checkbox]') || e.key === ' ') return; }
  if (e.target.matches && e.target.matches('button,summary,a') && (e.key === ' ' || e.key === 'Enter')) return;
  const key = e.key.length === 1 ? e.key.toLowerCase() : e.key, found = KEYS.find(k => k[0] === key);
  if (found && state.clip) { e.preventDefault(); found[3](e); }
}

function startControls() {
  const click = (name, action) => el(name).addEventListener('click', e => { action(e); if (e.detail) el(name).blur(); });
  click('play', () => play(!state.playing)); click('prev', () => step(-1)); click('next', () => step(1));
  click('loop', () => { if (state.loop) setLoop(null); else if (!loopAt(state.t)) setLoop([0, state.clip.n]); });
  click('mirror', toggle('mirror')); click('over', toggle('over')); click('click', toggle('click'));
  click('mute', () => { setMode('mute', !state.mute); if (gain) gain.gain.value = state.mute ? 0 : 1; });
  click('flag', () => nextFlag(false)); click('help', () => el('keys').showModal());
  click('theme', () => { setTheme(document.documentElement.dataset.theme === 'light' ? 'dark' : 'light', true); writeLink(); });
  click('link', copyLink);
  el('rate').addEventListener('change', () => { setRate(+el('rate').value); el('rate').blur(); });
  el('with').addEventListener('change', () => { compareWith(el('with').value).catch(failed); el('with').blur(); });
  el('field').addEventListener('change', () => { const t = state.t, loop = state.loop; openItem(state.item, { t, loop, field: el('field').value }); el('field').blur(); });
  el('with').replaceChildren(new Option('compare with…', ''), ...head.takes.map(name => new Option(plain(name), name)));
  el('with').hidden = !head.takes.length; el('over').hidden = !head.takes.length;
  el('field').replaceChildren(...head.fields.map(name => new Option(name, name)));
  el('field').hidden = head.fields.length < 2;
  for (const [, label, what] of KEYS) {
    const row = el('keytable').insertRow(), kbd = document.createElement('kbd');
    kbd.textContent = label; row.insertCell().append(kbd); row.insertCell().textContent = what;
  }
  startCamera();
}

async function copyLink() {
  const address = location.href.split('#')[0] + linkNow();
  try { await navigator.clipboard.writeText(address); el('link').textContent = 'Copied'; } catch (e) { prompt('Link', address); }
  setTimeout(() => { el('link').textContent = 'Copy link'; }, 1200);
}

function startCamera() {
  let from = null;
  canvas.addEventListener('pointerdown', e => { from = [e.clientX, e.clientY]; canvas.setPointerCapture(e.pointerId); });
  canvas.addEventListener('pointermove', e => {
    if (!from) return;
    camera.yaw -= (e.clientX - from[0]) * 0.008;
    camera.pitch = Math.max(-0.1, Math.min(1.5, camera.pitch + (e.clientY - from[1]) * 0.006));
    from = [e.clientX, e.clientY]; state.dirty = true;
  });
  for (const end of ['pointerup', 'pointercancel']) canvas.addEventListener(end, () => { from = null; });
  canvas.addEventListener('wheel', e => { if (!wholePage && !root.contains(document.activeElement)) return; e.preventDefault(); camera.zoom = Math.max(0.3, Math.min(6, camera.zoom * Math.exp(e.deltaY * 0.001))); state.dirty = true; }, { passive: false });
}

function about() {
  const n = head.clips, minutes = (head.hours * 60).toFixed(1);
  el('name').textContent = plain(head.name);
  el('about').textContent = n + (n === 1 ? ' clip' : ' clips') + ' · ' + head.windows + ' windows · ' + minutes + ' min · ' + head.rate + ' fps';
  el('foot').textContent = plain([head.notice, head.licence && 'Licence: ' + head.licence, head.citation && 'Cite: ' + head.citation].filter(Boolean).join('  ·  '));
  root.classList.toggle('single', items.length < 2 || !!page.single);
}

function tick() {
  advance();
  if (state.clip) {
    sizeCanvas(canvas); sizeCanvas(lanes);
    if (state.dirty) { state.dirty = false; drawStage(); drawLanes(); showNow(); }
    if (el('field').value !== state.clip.field) el('field').value = state.clip.field;
  }
  requestAnimationFrame(tick);
}

const asked = readLink().theme || new URLSearchParams(location.search).get('theme');
setTheme(asked || (document.documentElement.dataset.theme ? document.documentElement.dataset.theme : matchMedia('(prefers-color-scheme: light)').matches ? 'light' : 'dark'), false);
about();
startControls();
startList();
(wholePage ? window : root).addEventListener('keydown', onKey);
window.addEventListener('hashchange', () => followLink().catch(failed));
setInterval(metronome, 40);
requestAnimationFrame(tick);
const ready = followLink().catch(failed).then(() => { root.dataset.ready = '1'; });
// For tests, and for pages that hold this one.
window.dancedataViewer = { state, items, ready, camera, play, seek, setLoop, openItem, get shown() { return shown; }, get context() { return context; }, get gain() { return gain; }, get anchor() { return anchor; } };
