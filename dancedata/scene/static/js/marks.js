// Marks of the person who looks: stars, rejects and notes, kept in the browser, saved as rows of segments.
import { el, head, make, page } from './data.js';
import { drawRows } from './list.js';
import { state } from './state.js';

const MARKS_KEY = `dancedata-marks ${head.made || head.name}`;
let marks = readMarks();

function readMarks() {
  try {
    return JSON.parse(localStorage.getItem(MARKS_KEY)) || [];
  } catch (_e) {
    return []; // a frame in a notebook has no storage
  }
}

function keepMarks() {
  try {
    localStorage.setItem(MARKS_KEY, JSON.stringify(marks));
  } catch (_e) {
    /* they stay until the page is closed */
  }
  showMarks();
}

export function showMarks() {
  el('marks').hidden = !marks.length;
  el('marks').textContent = `Marks (${marks.length})`;
  drawRows(true);
  state.dirty = true;
}

// The clip that a mark is of, seconds from its first frame, and whether it is of the whole group.
function markPlace() {
  const members = state.item.members;
  const k = members && state.dancer !== null ? state.dancer : 0;
  const clip = members ? members[k][0] : state.item.id;
  return { clip, whole: !!members && state.dancer === null, begin: state.item.start / head.fps };
}

const sameMark = (a, b) => a.clip === b.clip && a.label === b.label && a.start === b.start && !!a.whole === !!b.whole;

// Sets a mark, or takes it away if it is there.
function toggleMark(mark) {
  const before = marks.length;
  marks = marks.filter(other => !sameMark(other, mark));
  const added = marks.length === before;
  if (added) marks.push(mark);
  el('toast').textContent = `${added ? '' : 'no '}${mark.label} ${mark.text || ''}`.trim();
  keepMarks();
}

export function starNow() {
  const { clip, whole, begin } = markPlace();
  toggleMark({ clip, whole, start: (begin + state.t).toFixed(3), label: 'star' });
}

// All of the clip, or of the window that is shown.
export function rejectNow() {
  const { clip, whole, begin } = markPlace();
  const end = page.list.windows ? (begin + state.clip.seconds).toFixed(3) : 'end';
  toggleMark({ clip, whole, start: begin.toFixed(3), end, label: 'reject' });
}

export function noteNow() {
  const { clip, whole, begin } = markPlace();
  const text = prompt('Note');
  if (text?.trim())
    toggleMark({ clip, whole, start: (begin + state.t).toFixed(3), label: 'note', text: text.trim() });
}

// Of one item: what the list shows, and the instants that the time axis shows.
export function marksOf(item) {
  const clips = new Set(item.members ? item.members.map(m => m[0]) : [item.id]);
  const begin = item.start / head.fps;
  return marks
    .filter(mark => clips.has(mark.clip) && +mark.start >= begin - 1e-3 && +mark.start < begin + item.seconds + 1e-3)
    .map(mark => ({ ...mark, at: +mark.start - begin }));
}

export const signOf = mark => ({ star: '★', reject: '✕', note: '✎' })[mark.label];

export const marksFile = () =>
  marks
    .map(mark => {
      const row = { clip: mark.clip, start: mark.start, layer: 'mark', label: mark.label, sided: 'no' };
      // A moment is a span of one frame, as the rows of a layer are of one kind.
      row.end = mark.end || (+mark.start + 1 / head.fps).toFixed(4);
      if (mark.text) row.text = mark.text;
      if (mark.whole) row.whole = true;
      if (head.made) row.self_sha256 = head.made;
      return `${JSON.stringify(row)}\n`;
    })
    .join('');

export function saveMarks() {
  const link = make('a');
  link.href = URL.createObjectURL(new Blob([marksFile()], { type: 'application/jsonl' }));
  link.download = 'marks.jsonl';
  link.click();
}
