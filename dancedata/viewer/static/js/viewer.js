// The page: it follows its address, starts the controls, and draws.
import { openItem, showNow } from './clip.js';
import { advance, anchor, context, gain, metronome, play, seek, setLoop } from './clock.js';
import { onKey, setMode, setTheme, startControls } from './controls.js';
import { el, head, items, page, root } from './data.js';
import { canvas, drawStage, sizeCanvas } from './figure.js';
import { readLink, wholePage } from './link.js';
import { shown, startList } from './list.js';
import { camera, failed, plain, state } from './state.js';
import { drawLanes, lanes } from './timeline.js';

async function followLink() {
  const h = readLink();
  const mine = items.filter(i => i.id === h.clip);
  const loop = (h.loop || '').match(/^(\d+)-(\d+)$/);
  if (h.theme) setTheme(h.theme, true);
  const item = mine.find(i => !h.window || i.start === +h.window) || mine[0] || shown[0] || items[0];
  if (!item) return;
  setMode('mirror', h.mirror === '1');
  setMode('over', h.over === '1');
  const known =
    mine.length || !h.clip
      ? {
          t: +h.t || 0,
          loop: loop && [+loop[1], +loop[2]],
          field: head.fields.includes(h.field) ? h.field : '',
          with: head.takes.includes(h.with) ? h.with : '',
        }
      : {};
  await openItem(item, known);
  if (h.clip && !mine.length) el('notes').textContent = `This dataset has no clip ${plain(h.clip)}`;
}

export function about() {
  const n = head.clips;
  const minutes = (head.hours * 60).toFixed(1);
  el('name').textContent = plain(head.name);
  el('about').textContent =
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
      drawStage();
      drawLanes();
      showNow();
    }
    if (el('field').value !== state.clip.field) el('field').value = state.clip.field;
  }
  requestAnimationFrame(tick);
}

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
startList(openItem);
(wholePage ? window : root).addEventListener('keydown', onKey);
window.addEventListener('hashchange', () => followLink().catch(failed));
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
