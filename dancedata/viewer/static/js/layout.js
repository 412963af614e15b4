// The page's layout: controls that find no room are in a sheet, and the edge above the lanes can be moved.
import { el, root } from './data.js';
import { state } from './state.js';

const bar = el('bar');
const lanesBox = el('tl');

function showMore(on) {
  root.classList.toggle('more', on);
  el('more').setAttribute('aria-expanded', on);
}

// One row of controls in a low or a narrow window.
export function fitControls() {
  root.classList.remove('tight');
  const oneRow = getComputedStyle(bar).flexWrap === 'nowrap';
  root.classList.toggle('tight', oneRow && bar.scrollWidth > bar.clientWidth);
  if (!root.classList.contains('tight')) showMore(false);
}

// Height of the lanes, CSS pixels; null: as high as they are.
function setLanesHeight(height) {
  const most = lanesBox.scrollHeight;
  const kept = height === null ? null : Math.max(40, Math.min(most, height));
  lanesBox.style.height = kept === null ? '' : `${kept}px`;
  el('edge').setAttribute('aria-valuenow', Math.round((100 * (kept ?? most)) / most));
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
  el('more').addEventListener('click', () => showMore(!root.classList.contains('more')));
  new ResizeObserver(fitControls).observe(bar);
  const edge = el('edge');
  let from = null;
  edge.addEventListener('pointerdown', e => {
    from = e.clientY + lanesBox.offsetHeight;
    edge.setPointerCapture(e.pointerId);
  });
  edge.addEventListener('pointermove', e => {
    if (from !== null) setLanesHeight(from - e.clientY);
  });
  for (const end of ['pointerup', 'pointercancel'])
    edge.addEventListener(end, () => {
      from = null;
    });
  edge.addEventListener('dblclick', () => setLanesHeight(null));
  edge.addEventListener('keydown', e => {
    const by = { ArrowUp: 16, ArrowDown: -16 }[e.key];
    if (by) setLanesHeight(lanesBox.offsetHeight + by);
  });
}
