// The page's layout: controls that find no room are in a sheet, and the edge above the lanes can be moved.
import { el, on, root } from './data.js';
import { state } from './state.js';

const bar = el('bar');
const lanesBox = el('tl');

const spare = [...el('extra').children];
// Those that leave the row first.
const RARE = 'full camera follow volume link field theme help flag mute click over with body mirror'.split(' ');

function showMore(on) {
  root.classList.toggle('more', on);
  el('more').ariaExpanded = on;
}

// Whether a control reaches into the right margin of the row.
function isFull() {
  const shown = [...bar.querySelectorAll('button, select, input')].filter(
    e => e.offsetParent && !el('sheet').contains(e),
  );
  return Math.max(...shown.map(e => e.getBoundingClientRect().right)) > bar.getBoundingClientRect().right - 13;
}

// Controls stay in one row; those without room are in the sheet.
export function fitControls() {
  const sheet = el('sheet');
  el('extra').replaceChildren(...spare);
  el('more').hidden = true;
  for (const name of RARE) {
    if (!isFull()) break;
    el('more').hidden = false;
    sheet.append(el(name));
  }
  if (el('more').hidden) showMore(false);
}

// Height of the lanes, CSS pixels; null: as high as they are.
function setLanesHeight(height) {
  const most = Math.min(lanesBox.scrollHeight, lanesBox.offsetHeight + el('stage').offsetHeight - 120);
  const kept = height === null ? null : Math.max(40, Math.min(most, height));
  root.classList.toggle('dragged', kept !== null);
  lanesBox.style.height = kept === null ? '' : `${kept}px`;
  el('edge').ariaValueNow = Math.round((100 * (kept ?? most)) / most);
  state.dirty = true;
}

// Until the first clip is there, only what does not need one.
export function enableControls(on) {
  for (const control of bar.querySelectorAll('button, select'))
    if (!['more', 'theme', 'help'].includes(control.dataset.dd)) control.disabled = !on;
  for (const name of ['zoomin', 'zoomout']) el(name).disabled = !on;
}

export function startLayout() {
  enableControls(false);
  on(el('more'), 'click', () => showMore(!root.classList.contains('more')));
  new ResizeObserver(fitControls).observe(bar);
  const edge = el('edge');
  let from = null;
  on(edge, 'pointerdown', e => {
    from = e.clientY + lanesBox.offsetHeight;
    edge.setPointerCapture(e.pointerId);
  });
  on(edge, 'pointermove', e => {
    if (from !== null) setLanesHeight(from - e.clientY);
  });
  for (const end of ['pointerup', 'pointercancel'])
    on(edge, end, () => {
      from = null;
    });
  on(edge, 'dblclick', () => setLanesHeight(null));
  on(edge, 'keydown', e => {
    const by = { ArrowUp: 16, ArrowDown: -16 }[e.key];
    if (by) setLanesHeight(lanesBox.offsetHeight + by);
  });
}
