// The list of clips: filters, order, and rows that exist only while they are seen.
import { el, fetched, items, make, on, option, page, plain } from './data.js';
import { failed, state } from './state.js';

const ROW = 46;
const listBox = el('list');
const rowBox = el('rows');
export let shown = items;
let drawnRows = new Map();
let open = () => {};
let signsOf = () => '';
const describe = item =>
  [
    item.split,
    item.members && `${item.members.length} dancer${item.members.length > 1 ? 's' : ''}`,
    item.genre,
    item.music,
    `${item.seconds.toFixed(1)} s`,
  ]
    .filter(Boolean)
    .join('  ·  ');
const SORTS = {
  id: (a, b) => (a.name < b.name ? -1 : a.name > b.name ? 1 : 0),
  long: (a, b) => b.n - a.n,
  short: (a, b) => a.n - b.n,
  flags: (a, b) => b.flags - a.flags,
  sliding: (a, b) => (b.sliding ?? -1) - (a.sliding ?? -1),
};

function filterItems() {
  const text = el('q').value.toLowerCase();
  const split = el('split').value;
  const genre = el('genre').value;
  const flagged = el('flagged').checked;
  shown = items.filter(
    i =>
      (!text || i.text.includes(text)) &&
      (!split || i.split === split) &&
      (!genre || i.genre === genre) &&
      (!flagged || i.flags),
  );
  const order = SORTS[el('sort').value];
  if (order) shown = shown.slice().sort((a, b) => order(a, b) || a.number - b.number);
  el('count').textContent = `${shown.length} of ${items.length}`;
  el('none').hidden = !!shown.length;
  el('nonetext').textContent = text ? `no clip matches '${plain(el('q').value)}'` : 'no clip matches';
  rowBox.style.height = `${shown.length * ROW + 12}px`;
  drawRows(true);
}

function rowOf(item, place) {
  const row = make('div');
  const name = make('b');
  const count = make('span');
  row.className = 'item';
  row.id = `dd-item-${item.number}`;
  row.setAttribute('role', 'option');
  row.ariaPosInSet = place + 1;
  row.ariaSetSize = shown.length;
  row.title = plain(item.name);
  // The ends of long names are what differs: the middle gives way.
  const cut = row.title.length > 24 ? row.title.length - 12 : row.title.length;
  name.append(make('span', row.title.slice(0, cut)), make('span', row.title.slice(cut)));
  count.className = 'n';
  if (item.flags) {
    count.textContent = `▲ ${item.flags}`;
    count.title = item.flags + (item.flags > 1 ? ' flags' : ' flag');
  }
  const signs = signsOf(item);
  if (signs) count.textContent = `${signs} ${count.textContent}`;
  const sliding = el('sort').value === 'sliding' && item.sliding !== undefined && item.sliding !== null;
  const about = make(
    'small',
    (sliding ? `slides ${(item.sliding * 100).toFixed(1)} cm/s  ·  ` : '') + plain(describe(item)),
  );
  row.append(name, count, about);
  on(row, 'click', () => open(item));
  return row;
}

export function drawRows(anew) {
  const first = Math.max(0, Math.floor(listBox.scrollTop / ROW) - 4);
  const last = Math.min(shown.length, first + Math.ceil((listBox.clientHeight || 600) / ROW) + 9);
  const wanted = new Map();
  for (let k = first; k < last; k++) wanted.set(shown[k].number, k);
  if (anew) {
    rowBox.replaceChildren();
    drawnRows = new Map();
  }
  for (const [number, row] of drawnRows)
    if (!wanted.has(number)) {
      row.remove();
      drawnRows.delete(number);
    }
  for (const [number, k] of wanted) {
    let row = drawnRows.get(number);
    if (!row) {
      row = rowOf(shown[k], k);
      drawnRows.set(number, row);
      rowBox.append(row);
    }
    row.style.top = `${6 + k * ROW}px`;
    row.ariaSelected = state.item === shown[k];
  }
  const selected = state.item && drawnRows.has(state.item.number);
  if (selected) listBox.setAttribute('aria-activedescendant', `dd-item-${state.item.number}`);
  else listBox.removeAttribute('aria-activedescendant');
}

export function showSelected() {
  const k = shown.indexOf(state.item);
  const y = 6 + k * ROW;
  if (k >= 0 && (y < listBox.scrollTop || y + ROW > listBox.scrollTop + listBox.clientHeight))
    listBox.scrollTop = Math.max(0, y - listBox.clientHeight / 3);
  drawRows(false);
}

export function step(by) {
  if (!shown.length) return;
  const k = shown.indexOf(state.item);
  open(shown[k < 0 ? 0 : (k + by + shown.length) % shown.length]);
}

function options(name, all, values) {
  const box = el(name);
  box.replaceChildren(new Option(all, ''), ...values.map(option));
  box.parentElement.hidden = box.hidden = values.length < (name === 'split' ? 2 : 1) && name !== 'sort';
}

// How far feet slide needs every clip's joints: the server measures them when this order is chosen first.
async function measureSliding() {
  for (;;) {
    const reply = await (await fetched('sliding')).json();
    reply.values.forEach((value, k) => {
      items[k].sliding = value;
    });
    filterItems();
    if (reply.done || el('sort').value !== 'sliding') return;
    el('count').textContent += `, measured ${reply.count}`;
    await new Promise(r => setTimeout(r, 400));
  }
}

// `signs` tells what stands beside an item in the list.
export function showSigns(signs) {
  signsOf = signs;
}

// Shows the clips that a text is in, alone.
export function showOnly(text) {
  el('q').value = text;
  for (const name of ['split', 'genre']) el(name).value = '';
  el('flagged').checked = false;
  listBox.scrollTop = 0;
  filterItems();
}

// `openItem` is called with the item that is chosen.
export function startList(openItem) {
  open = openItem;
  options('split', 'all splits', [...new Set(items.map(i => i.split).filter(Boolean))]);
  options('genre', 'all genres', [...new Set(items.map(i => i.genre).filter(Boolean))].sort());
  el('split').parentElement.hidden = el('split').hidden && el('genre').hidden;
  if (page.server) el('sort').append(new Option('most sliding first', 'sliding'));
  for (const name of ['q', 'split', 'genre', 'flagged'])
    on(el(name), 'input', () => {
      listBox.scrollTop = 0;
      filterItems();
    });
  on(el('sort'), 'input', () => {
    listBox.scrollTop = 0;
    filterItems();
    if (el('sort').value === 'sliding') measureSliding().catch(failed);
  });
  on(el('clear'), 'click', () => {
    for (const name of ['q', 'split', 'genre']) el(name).value = '';
    el('flagged').checked = false;
    filterItems();
    el('q').focus();
  });
  on(listBox, 'scroll', () => drawRows(false));
  on(listBox, 'keydown', e => {
    const by = { ArrowDown: 1, ArrowUp: -1, PageDown: 8, PageUp: -8 }[e.key];
    if (by) {
      e.preventDefault();
      e.stopPropagation();
      step(by);
    }
  });
  new ResizeObserver(() => drawRows(false)).observe(listBox);
  on(el('drawer'), 'click', () => {
    const shownPicker = el('picker').classList.toggle('open');
    el('drawer').ariaExpanded = shownPicker;
    drawRows(false);
  });
  filterItems();
}
