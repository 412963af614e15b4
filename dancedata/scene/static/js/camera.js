// The camera: turned, moved and zoomed by pointers and keys, with views from the front, left, back and top.
import { together } from './dancers.js';
import { el, on, root } from './data.js';
import { canvas, facingNow } from './figure.js';
import { wholePage } from './link.js';
import { camera, state } from './state.js';

const PITCH = { front: 0.08, left: 0.08, back: 0.08, top: 1.5 };
const TURN = { front: 0, left: Math.PI / 2, back: Math.PI, top: 0 };

// `front` and the others are those of the dancer now; in a group, of the world. `reset`: as at the beginning.
export function lookFrom(name) {
  Object.assign(camera, { zoom: 1, right: 0, up: 0, still: true });
  if (name === 'reset') Object.assign(camera, { yaw: 0.55, pitch: 0.2 });
  else Object.assign(camera, { yaw: (together() ? 0 : facingNow()) + TURN[name], pitch: PITCH[name] });
  state.dirty = true;
}

export function turn(yaw, pitch) {
  camera.yaw += yaw;
  camera.pitch = Math.max(-0.1, Math.min(1.5, camera.pitch + pitch));
  state.dirty = true;
}

function zoom(factor) {
  camera.zoom = Math.max(0.15, Math.min(6, camera.zoom * factor));
  state.dirty = true;
}

// In shares of the stage's height.
function pan(dx, dy) {
  camera.right += dx / canvas.clientHeight;
  camera.up += dy / canvas.clientHeight;
  state.dirty = true;
}

export function fullScreen() {
  if (document.fullscreenElement) document.exitFullscreen();
  else el('stage').requestFullscreen?.();
}

// `click` is called with the place of a pointer that went up where it had gone down.
export function startCamera(click) {
  const down = new Map();
  let moved = 0;
  on(canvas, 'pointerdown', e => {
    if (!down.size) moved = 0;
    down.set(e.pointerId, [e.clientX, e.clientY]);
    canvas.setPointerCapture(e.pointerId);
  });
  on(canvas, 'pointermove', e => {
    const from = down.get(e.pointerId);
    if (!from) return;
    const [dx, dy] = [e.clientX - from[0], e.clientY - from[1]];
    moved += Math.abs(dx) + Math.abs(dy);
    const other = [...down].find(([id]) => id !== e.pointerId)?.[1];
    if (other) {
      const apart = p => Math.max(20, Math.hypot(p[0] - other[0], p[1] - other[1]));
      zoom(apart(from) / apart([e.clientX, e.clientY]));
      pan(dx / 2, dy / 2);
    } else if (e.shiftKey) pan(dx, dy);
    else turn(-dx * 0.008, dy * 0.006);
    down.set(e.pointerId, [e.clientX, e.clientY]);
  });
  on(canvas, 'pointerup', e => {
    if (down.has(e.pointerId) && down.size === 1 && moved < 4) click(e);
  });
  for (const end of ['pointerup', 'pointercancel']) on(canvas, end, e => down.delete(e.pointerId));
  for (const kind of ['enter', 'leave'])
    on(canvas, `pointer${kind}`, () => {
      state.pointed = kind === 'enter';
      state.dirty = true;
    });
  on(canvas, 'dblclick', () => lookFrom('reset'));
  on(
    canvas,
    'wheel',
    e => {
      if (!wholePage && !root.contains(document.activeElement)) return;
      e.preventDefault();
      zoom(Math.exp(e.deltaY * 0.001));
    },
    { passive: false },
  );
  on(el('camera'), 'change', () => {
    lookFrom(el('camera').value);
    el('camera').value = '';
    el('camera').blur();
  });
  el('full').hidden = !document.fullscreenEnabled;
}
