// What is shown, and the camera: one object each, which every module reads.
import { el, head, plain, root } from './data.js';

// How a body is drawn: 0 sticks, 1 limbs, 2 a skin.
export const SKIN = 2;
export const state = {
  clip: null,
  item: null,
  // Place of the dancer of a group who is shown alone; null: all of them.
  dancer: null,
  t: 0,
  playing: false,
  rate: 1,
  loop: null,
  mirror: false,
  body: SKIN,
  // Whether that was chosen, by key or link: it is then not given up where it is slow.
  bodyChosen: !!head.model,
  over: false,
  other: null,
  click: false,
  mute: false,
  volume: 1,
  follow: true,
  field: '',
  // Whether the pointer is over the stage.
  pointed: false,
  // The window under the pointer.
  hovered: null,
  drawn: 0,
  dirty: true,
  themeChosen: false,
};

export const duration = () => (state.clip ? state.clip.seconds : 0);
export const frameRate = () => (state.clip.figure ? state.clip.figure.rate : state.clip.fps);
export const loopSeconds = () =>
  state.loop && [state.loop[0] / state.clip.fps, Math.min(duration(), state.loop[1] / state.clip.fps)];
// `right`, `up`: how far the picture is moved, in heights of the stage. `placed`: whether it has been near this clip.
export const camera = {
  yaw: 0.55,
  pitch: 0.2,
  zoom: 1,
  right: 0,
  up: 0,
  x: 0,
  y: 0,
  z: 0,
  still: true,
  placed: false,
};

export function failed(error) {
  const gone = /rebuilt/.test(error.message);
  root.classList.toggle('ended', !!error.ended);
  el('notes').textContent = gone
    ? 'The dataset was built again: start dancedata view again.'
    : error.ended
      ? 'The server has ended: start dancedata view again. The end of this link, from #, opens this moment there.'
      : plain(String(error.message || error));
}
