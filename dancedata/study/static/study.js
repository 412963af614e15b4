// A study: two dancers at a time in the viewer above, a choice, and the answers as a table.
const study = JSON.parse(document.getElementById('dd-study').textContent);
const viewer = window.dancedataViewer;
const at = name => document.querySelector(`[data-st="${name}"]`);
const answers = [];
let order = [];
let place = -1;
let began = 0;
let plays = 0;

// Numbers from 0 to 1 by a text: the same rater of the same study has the same order (FNV-1a, mulberry32).
function numbersOf(text) {
  let seed = 0x811c9dc5;
  for (const c of new TextEncoder().encode(text)) seed = Math.imul(seed ^ c, 0x01000193);
  return () => {
    seed = (seed + 0x6d2b79f5) | 0;
    let t = Math.imul(seed ^ (seed >>> 15), 1 | seed);
    t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
    return ((t ^ (t >>> 14)) >>> 0) / 4294967296;
  };
}

function orderOf(who) {
  const next = numbersOf(`${study.id} ${study.seed} ${who}`);
  const places = study.trials.map((_, k) => k);
  for (let k = places.length - 1; k > 0; k--) {
    const other = Math.floor(next() * (k + 1));
    [places[k], places[other]] = [places[other], places[k]];
  }
  return places;
}

// The answer of the trial that is shown, which "back" brings up again.
const answer = () => {
  const trial = order[place];
  answers[trial] = answers[trial] || { choice: '', reasons: new Set(), plays: 0, seconds: 0, time: '' };
  return answers[trial];
};

function leave() {
  const now = answer();
  now.plays += plays;
  now.seconds += (performance.now() - began) / 1000;
  now.time = new Date().toISOString();
}

async function show(k) {
  place = k;
  for (const name of ['intro', 'trial', 'end']) at(name).hidden = name !== (k < order.length ? 'trial' : 'end');
  if (k >= order.length) {
    await viewer.play(false);
    at('csv').value = table();
    at('save').focus();
    return;
  }
  began = performance.now();
  plays = 0;
  at('place').textContent = `${k + 1} of ${order.length}`;
  at('back').disabled = !k;
  fill();
  await viewer.openItem(viewer.items[order[k]]);
  viewer.camera.yaw = 0;
  viewer.camera.pitch = 0.12;
  await again();
}

async function again() {
  plays++;
  viewer.seek(0);
  await viewer.play(true);
}

function fill() {
  const now = answer();
  for (const side of ['left', 'right']) at(side).setAttribute('aria-pressed', now.choice === side);
  for (const box of at('reasons').querySelectorAll('input')) box.checked = now.reasons.has(box.value);
  at('next').disabled = !now.choice;
}

function choose(side) {
  answer().choice = side;
  fill();
}

function next() {
  if (!answer().choice) return;
  leave();
  show(place + 1);
}

const cell = value => {
  const text = String(value);
  // A cell that begins like a formula is text for programs that would compute it.
  const safe = /^[=+\-@\t\r]/.test(text) ? `'${text}` : text;
  return /[",\n\r]/.test(safe) ? `"${safe.replace(/"/g, '""')}"` : safe;
};

function table() {
  const who = at('who').value.trim() || 'anonymous';
  const rows = order.map((trial, k) => {
    const asked = study.trials[trial];
    const a = answers[trial];
    const row = {
      ...asked,
      study: study.id,
      participant: who,
      order: k,
      trial,
      choice: a.choice,
      chosen: asked[a.choice],
      reasons: study.reasons.filter(reason => a.reasons.has(reason)).join('; '),
      plays: a.plays,
      seconds: a.seconds.toFixed(1),
      time: a.time,
    };
    return study.columns.map(column => cell(row[column])).join(',');
  });
  return `${[study.columns.join(','), ...rows].join('\n')}\n`;
}

function save() {
  const file = new Blob([table()], { type: 'text/csv' });
  const link = document.createElement('a');
  link.href = URL.createObjectURL(file);
  link.download = `study-${study.id}-${(at('who').value.trim() || 'anonymous').replace(/[^\w-]+/g, '_')}.csv`;
  link.click();
}

at('ask').textContent = study.question;
at('question').textContent = study.question;
for (const reason of study.reasons) {
  const label = document.createElement('label');
  const box = document.createElement('input');
  box.type = 'checkbox';
  box.value = reason;
  box.addEventListener('change', () =>
    box.checked ? answer().reasons.add(reason) : answer().reasons.delete(reason),
  );
  label.append(box, ` ${reason}`);
  at('reasons').append(label);
}
at('begin').addEventListener('click', () => {
  order = orderOf(at('who').value.trim() || 'anonymous');
  show(0);
});
at('left').addEventListener('click', () => choose('left'));
at('right').addEventListener('click', () => choose('right'));
at('again').addEventListener('click', again);
at('next').addEventListener('click', next);
at('back').addEventListener('click', () => {
  leave();
  show(place - 1);
});
at('save').addEventListener('click', save);
// Before the viewer's own keys, which are for one who knows what is shown.
window.addEventListener(
  'keydown',
  e => {
    if (place < 0 || place >= order.length || e.ctrlKey || e.metaKey || e.altKey) return;
    const done = { 1: () => choose('left'), 2: () => choose('right'), r: again, Enter: next }[e.key];
    if (e.key === 'Tab' || (e.key === ' ' && document.activeElement?.closest('.study'))) return;
    e.stopImmediatePropagation();
    if (!done || (e.key === 'Enter' && document.activeElement?.closest('.study button'))) return;
    e.preventDefault();
    done();
  },
  true,
);
window.addEventListener('beforeunload', e => {
  if (place >= 0 && place < order.length) e.preventDefault();
});

// For tests.
window.dancedataStudy = { table, orderOf, show, choose, next };
