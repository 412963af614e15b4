// The address of the page: #clip=ID&t=5.800&loop=90-240
import { page } from './data.js';
import { state } from './state.js';

export const wholePage = document.documentElement.classList.contains('dd-page');

export function linkNow() {
  const members = state.item.members;
  const name = members && state.dancer !== null ? members[state.dancer][0] : state.item.id;
  const parts = [`${members && state.dancer === null ? 'group' : 'clip'}=${encodeURIComponent(name)}`];
  if (page.list.windows) parts.push(`window=${state.item.start}`);
  parts.push(`t=${state.t.toFixed(3)}`);
  if (state.loop) parts.push(`loop=${state.loop.join('-')}`);
  if (state.field) parts.push(`field=${encodeURIComponent(state.field)}`);
  if (state.other) parts.push(`with=${encodeURIComponent(state.other.name)}`);
  if (state.mirror) parts.push('mirror=1');
  if (state.over) parts.push('over=1');
  if (state.bodyChosen) parts.push(`body=${state.body}`);
  if (state.themeChosen) parts.push(`theme=${document.documentElement.dataset.theme}`);
  return `#${parts.join('&')}`;
}

let linkTimer = 0;
let pending = null;

// Writes what is due to be written, now.
export function flushLink() {
  clearTimeout(linkTimer);
  pending?.();
  pending = null;
}

// `another`: as a further entry of the history.
export function writeLink(another = false) {
  clearTimeout(linkTimer);
  if (!wholePage) return;
  const before = location.hash;
  const link = linkNow();
  pending = () => {
    try {
      // Not over a link that was opened meanwhile and is still to be followed.
      if (location.hash === before) history[another ? 'pushState' : 'replaceState'](null, '', link);
    } catch (_e) {
      /* a page inside another one has no address */
    }
  };
  if (another) flushLink();
  else linkTimer = setTimeout(flushLink, 120);
}

// The address, or where a saved page begins. Not URLSearchParams: it reads a plus sign as a space.
export function readLink() {
  const found = {};
  for (const part of (location.hash || page.at || '').slice(1).split('&')) {
    const [key, value = ''] = part.split(/=(.*)/s);
    try {
      found[key] = decodeURIComponent(value);
    } catch (_e) {
      found[key] = value;
    }
  }
  return found;
}
