// The page: it follows its address, starts the controls, and draws.
import { explainLanes, lanes, rows, view } from './axis.js';
import { chooseDancer, openItem, readySkin, setBody, showNow } from './clip.js';
import { advance, anchor, context, gain, metronome, play, playSilently, seek, setLoop } from './clock.js';
import { onKey, setMode, setTheme, startControls } from './controls.js';
import { drawCrowd } from './crowd.js';
import { together } from './dancers.js';
import { el, head, items, on, page, plain, root } from './data.js';
import { canvas, conesNow, drawStage, far, placingNow, pointsNow, sizeCanvas } from './figure.js';
import { givesUp, skinPicture } from './gl.js';
import { startLayout } from './layout.js';
import { readLink, wholePage } from './link.js';
import { shown, showOnly, showSigns, startList } from './list.js';
import { marksFile, marksOf, showMarks, signOf } from './marks.js';
import { grow } from './skin.js';
import { camera, failed, SKIN, state } from './state.js';
import { drawLanes, layOut } from './timeline.js';

async function followLink() {
  const h = readLink();
  const named = h.group ?? h.clip;
  const mine = items.filter(i =>
    h.group === undefined && i.members
      ? i.members.some(m => m[0] === h.clip)
      : !!i.members === (h.group !== undefined) && i.id === named,
  );
  const loop = (h.loop || '').match(/^(\d+)-(\d+)$/);
  if (h.theme) setTheme(h.theme, true);
  const item = mine.find(i => !h.window || i.start === +h.window) || mine[0] || shown[0] || items[0];
  if (!item) return;
  if (h.list !== undefined) showOnly(h.list);
  setMode('mirror', h.mirror === '1');
  setMode('over', h.over === '1');
  if (/^[012]$/.test(h.body)) setBody(+h.body, true);
  const known =
    mine.length || !named
      ? {
          linked: true,
          t: +h.t || 0,
          loop: loop && [+loop[1], +loop[2]],
          field: head.fields.includes(h.field) ? h.field : '',
          with: head.takes.includes(h.with) || (page.server && items.some(i => i.name === h.with)) ? h.with : '',
          dancer: placeOf(item, h.clip),
        }
      : { linked: true };
  await openItem(item, known);
  if (h.play === '1' && !matchMedia('(prefers-reduced-motion: reduce)').matches) {
    playSilently();
    setTimeout(explainLanes, 200); // once they are drawn
  }
  if (named && !mine.length)
    el('notes').textContent = `This dataset has no ${h.group === undefined ? 'clip' : 'group'} ${plain(named)}`;
}

// The dancer of a group whose clip this is; null where it is of no group.
function placeOf(item, clip) {
  const k = (item.members || []).findIndex(m => m[0] === clip);
  return k < 0 ? null : k;
}

export function about() {
  const n = head.clips;
  const minutes = (head.hours * 60).toFixed(1);
  el('name').textContent = plain(head.name);
  el('about').textContent =
    (head.groups ? `${head.groups}${head.groups === 1 ? ' group' : ' groups'} · ` : '') +
    n +
    (n === 1 ? ' clip' : ' clips') +
    ' · ' +
    head.windows +
    ' windows · ' +
    minutes +
    ' min · ' +
    head.rate +
    ' fps';
  el('foot').textContent = plain(
    [head.notice, head.licence && `Licence: ${head.licence}`, head.citation && `Cite: ${head.citation}`]
      .filter(Boolean)
      .join('  ·  '),
  );
  root.classList.toggle('single', items.length < 2 || !!page.single);
}

function tick() {
  advance();
  if (state.clip) {
    sizeCanvas(canvas);
    sizeCanvas(lanes);
    if (state.dirty) {
      state.dirty = false;
      if (state.body === SKIN && givesUp(performance.now())) setBody(1, state.bodyChosen);
      if (together()) drawCrowd();
      else drawStage();
      drawLanes();
      showNow();
    }
    if (el('field').value !== state.clip.field) el('field').value = state.clip.field;
  }
  requestAnimationFrame(tick);
}

// The dancers of a wall stand in rows: they are seen from the front.
if (head.wall) camera.yaw = 0.12;

const asked = readLink().theme || new URLSearchParams(location.search).get('theme');
setTheme(
  asked ||
    (document.documentElement.dataset.theme
      ? document.documentElement.dataset.theme
      : matchMedia('(prefers-color-scheme: light)').matches
        ? 'light'
        : 'dark'),
  false,
);

about();
startControls();
startLayout();
layOut(null);
on(window, 'resize', () => layOut(state.clip));
startList(openItem);
showSigns(item => [...new Set(marksOf(item).map(signOf))].join(''));
showMarks();
on(wholePage ? window : root, 'keydown', onKey);
on(window, 'hashchange', () => followLink().catch(failed));
setInterval(metronome, 40);
requestAnimationFrame(tick);
const ready = followLink()
  .catch(failed)
  .then(() => {
    root.dataset.ready = '1';
  });

// For tests, and for pages that hold this one.
window.dancedataViewer = {
  state,
  items,
  ready,
  camera,
  play,
  seek,
  setLoop,
  openItem,
  chooseDancer,
  marksFile,
  rows,
  view,
  pointsNow,
  setBody: async (level, chosen) => {
    setBody(level, chosen);
    await readySkin();
  },
  placingNow,
  skin: () => grow(state.clip.figure),
  get skinPicture() {
    return skinPicture();
  },
  get far() {
    return far;
  },
  get cones() {
    return conesNow();
  },
  get shown() {
    return shown;
  },
  get context() {
    return context;
  },
  get gain() {
    return gain;
  },
  get anchor() {
    return anchor;
  },
};
