// The page's data, and clips as they are loaded: joints, contacts, curves.
export const page = JSON.parse(document.getElementById('dd-data').textContent);
export const root = document.querySelector('[data-dd=root]');
export const el = name => root.querySelector(`[data-dd="${name}"]`);
export const make = (tag, text = '') => Object.assign(document.createElement(tag), { textContent: text });
export const on = (target, kind, act, options) => target.addEventListener(kind, act, options);
export const head = page.head;
const clipRows = page.list.clips;

// Characters that turn the direction of text are shown as what they are.
export const plain = text =>
  text.replace(
    // biome-ignore lint/suspicious/noControlCharactersInRegex: control characters are what is looked for
    /[\u0000-\u001f\u007f-\u009f\u061c\u200b-\u200f\u2028-\u202e\u2060-\u2069\ufeff]/g,
    c => `\\u${c.charCodeAt(0).toString(16).padStart(4, '0')}`,
  );

export const option = value => new Option(plain(value), value);

// One row of the list: a clip, or a window of it.
export const items = page.list.items.map(([c, start, n, flags], number) => {
  const [id, split, genre, music, dancer, source, members] = clipRows[c];
  const name = page.list.windows ? `${id}@${start}` : id;
  return {
    number,
    id,
    name,
    split,
    genre,
    music,
    dancer,
    source,
    start,
    n,
    flags,
    // Of a group: [clip, number, role] of each dancer.
    members: members || null,
    seconds: n / head.fps,
    text: [name, music, dancer, genre, ...(members || []).flat()].join('\n').toLowerCase(),
  };
});

const bytesOf = text => Uint8Array.from(atob(text), c => c.charCodeAt(0));

async function unpacked(text) {
  const stream = new Blob([bytesOf(text)]).stream().pipeThrough(new DecompressionStream('gzip'));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// Low bytes, then high bytes, of differences in time, coordinate by coordinate.
async function inTime(text, frames) {
  const bytes = await unpacked(text);
  const n = bytes.length / 2;
  const width = n / frames;
  const values = new Int16Array(n);
  for (let k = 0; k < width; k++) {
    for (let f = 0, sum = 0; f < frames; f++) {
      const i = k * frames + f;
      sum += bytes[i] | (bytes[n + i] << 8);
      values[f * width + k] = sum;
    }
  }
  return values;
}

async function figureOf(packed) {
  const steps = await inTime(packed.data, packed.frames);
  const width = steps.length / packed.frames;
  const places = Float32Array.from(steps, (v, i) => packed.origin[(i % width) % 3] + v * packed.unit);
  const figure = { ...packed, places, width, count: width / 3, contacts: await unpacked(packed.contacts) };
  figure.look = packed.look && new Int8Array((await unpacked(packed.look)).buffer);
  figure.mirror = packed.joints.map((_, j) => j);
  for (const [a, b] of packed.pairs) {
    figure.mirror[a] = b;
    figure.mirror[b] = a;
  }
  figure.room = roomOf(figure);
  figure.thick = packed.joints.map(name => thickness(figure, name));
  return figure;
}

// What the camera shows: a dancer who stands, less where a clip stays near the floor in 99 % of its frames.
function roomOf(figure) {
  const tops = new Float32Array(figure.frames);
  for (let i = 0; i < figure.frames; i++) {
    let top = -Infinity;
    for (let j = 1; j < figure.width; j += 3) top = Math.max(top, figure.places[i * figure.width + j]);
    tops[i] = top - figure.floor;
  }
  const high = tops.sort()[Math.floor(0.99 * (figure.frames - 1))] + 0.1 * figure.tall;
  return Math.max(0.7 * figure.tall, Math.min(figure.tall, high));
}

// Width of a bone, for a dancer of 1.7 m.
function thickness(figure, name) {
  const scale = figure.tall / 1.7;
  if (/eye|jaw/i.test(name)) return 0;
  if (/thumb|index|middle|ring|pinky|finger/i.test(name)) return 0.014 * scale;
  if (/spine|chest|neck|collar|clavicle|hip|pelvis/i.test(name)) return 0.062 * scale;
  if (/knee|ankle|leg/i.test(name)) return 0.052 * scale;
  if (/head/i.test(name)) return 0.055 * scale;
  if (/hand|foot|toe/i.test(name)) return 0.032 * scale;
  return 0.042 * scale;
}

async function curveOf(packed) {
  if (!packed) return null;
  const steps = new Uint16Array((await unpacked(packed.data)).buffer);
  return { ...packed, values: Float32Array.from(steps, v => (v / 65535) * packed.max) };
}

async function dancerOf(payload) {
  const dancer = { ...payload };
  dancer.figure = payload.figure && (await figureOf(payload.figure));
  dancer.speed = await curveOf(payload.speed);
  dancer.flagTimes = [...new Set(dancer.flags.map(f => f[0]).filter(t => t !== null))].sort((a, b) => a - b);
  return dancer;
}

async function pairOf(pair) {
  const [distance, ...facing] = await Promise.all([pair.distance, ...pair.facing].map(curveOf));
  return { ...pair, distance, facing };
}

const shortened = name => (name.length > 33 ? `${name.slice(0, 16)}…${name.slice(-16)}` : name);

async function clipOf(payload) {
  const clip = await dancerOf(payload);
  clip.onset = await curveOf(payload.onset);
  clip.others = new Map();
  if (payload.members) {
    clip.members = await Promise.all(payload.members.map(dancerOf));
    for (const member of clip.members) member.called = shortened(plain(member.part));
    clip.pairs = await Promise.all(payload.pairs.map(pairOf));
    const [first, ...more] = clip.pairs.map(pair => pair.distance.values);
    clip.nearest = first?.map((metres, i) => Math.min(metres, ...more.map(values => values[i])));
    clip.reach = reachOf(clip.members.map(member => member.figure).filter(Boolean));
  }
  return clip;
}

// How far a dancer is at most from the middle of the group, metres.
function reachOf(figures) {
  let reach = 0;
  for (let i = 0; i < (figures[0]?.frames || 0); i++) {
    for (const axis of [0, 2]) {
      const places = figures.map(f => f.places[Math.min(i, f.frames - 1) * f.width + axis]);
      reach = Math.max(reach, (Math.max(...places) - Math.min(...places)) / 2);
    }
  }
  return reach;
}

const loaded = new Map();
const waiting = new Map();

// Side files of a saved page are scripts: a page that is opened as a file may not fetch anything.
window.dancedataClip = (number, payload) => {
  const done = waiting.get(number);
  if (done) done(payload);
};

function sideFile(number, address) {
  return new Promise((done, fail) => {
    waiting.set(number, done);
    const script = make('script');
    script.src = address;
    script.onerror = () => fail(new Error('the file with this clip is missing'));
    document.head.append(script);
  });
}

export async function fetched(address) {
  const reply = await fetch(address).catch(error => {
    throw Object.assign(error, { ended: true });
  });
  if (!reply.ok) throw new Error(await reply.text());
  return reply;
}

async function payloadOf(number, field) {
  if (page.server) return served(number, field, '?part=first');
  if (page.clips[number]) return page.clips[number];
  if (page.side?.[number]) return sideFile(number, page.side[number]);
  throw new Error('this clip is not part of this page');
}

const served = async (number, field, part) =>
  (await fetched(`clip/${number}${part}${field ? `&field=${encodeURIComponent(field)}` : ''}`)).json();

// The rest of a long clip, of which the first minute came first: its dancers take the place of those.
export async function loadRest(clip, field) {
  const whole = await clipOf(await served(clip.number, field, '?part=all'));
  for (const key of ['figure', 'speed', 'keys', 'members', 'pairs', 'nearest', 'reach'])
    if (key in whole) clip[key] = whole[key];
  clip.partial = false;
}

// The turns of the joints of a clip's figures, and of those that it is compared with, for a skin.
export async function loadTurns(clip, other, field) {
  const figures = (clip.members || [clip]).map(dancer => dancer.figure);
  if (page.server && figures.some(figure => figure && !('turns' in figure))) {
    const turns = await served(clip.number, field, '?part=turns');
    figures.forEach((figure, k) => {
      if (figure) figure.turns = turns[k];
    });
  }
  if (!model && figures.some(figure => figure?.model)) await loadModel();
  for (const figure of [...figures, ...(other?.members || [other]).map(found => found?.figure)])
    if (figure?.turns && !figure.turning) figure.turning = await inTime(figure.turns.data, figure.frames);
}

// The user's body model, as `grow` gives a skin.
export let model = null;

async function loadModel() {
  const made = {};
  for (const [key, kind, data] of await (await fetched('model')).json())
    made[key] = new window[kind]((await unpacked(data)).buffer);
  model = made;
}

// The last few clips stay in memory; more would fill it.
export async function loadClip(number, field) {
  const key = `${number} ${field}`;
  if (!loaded.has(key)) {
    loaded.set(key, payloadOf(number, field).then(clipOf));
    loaded.get(key).catch(() => loaded.delete(key));
    if (loaded.size > 8) loaded.delete(loaded.keys().next().value);
  }
  return loaded.get(key);
}

async function motionOf(found) {
  const figure = found.figure && (await figureOf(found.figure));
  return { ...found, figure, distance: found.distance && (await curveOf(found.distance)) };
}

export async function loadOther(clip, name) {
  if (!clip.others.has(name)) {
    const take = head.takes.indexOf(name);
    const way = take < 0 ? `beside/${items.find(i => i.name === name).number}` : `with/${take}`;
    const found = page.server
      ? await (await fetched(`clip/${clip.number}/${way}?field=${encodeURIComponent(clip.field)}`)).json()
      : clip.with?.[name] || { note: `this page has no ${name} of this clip` };
    const other = { ...(await motionOf(found)), name };
    if (found.members) other.members = await Promise.all(found.members.map(motionOf));
    clip.others.set(name, other);
  }
  return clip.others.get(name);
}

// Music is decoded whole: an <audio> element would be off by up to 0.2 s after a jump.
const decoder = window.OfflineAudioContext ? new OfflineAudioContext(1, 1, 44100) : null;

export async function loadMusic(clip) {
  if (clip.sound !== undefined) return clip.sound;
  clip.sound = null;
  let data = null;
  if (page.server && head.sound) {
    const reply = await fetch(`clip/${clip.number}/music`);
    clip.silence = decodeURIComponent(reply.headers.get('Dancedata-Note') || '');
    if (reply.ok) data = await reply.arrayBuffer();
    else clip.silence = await reply.text();
  } else if (page.audio?.[clip.number]) data = bytesOf(page.audio[clip.number]).buffer;
  if (data && decoder) {
    clip.sound = await decoder.decodeAudioData(data);
    clip.wave = waveOf(clip.sound);
  }
  return clip.sound;
}

function waveOf(buffer) {
  const x = buffer.getChannelData(0);
  const n = Math.min(4000, Math.ceil(x.length / 64));
  const peaks = new Float32Array(n);
  for (let i = 0; i < n; i++) {
    const end = Math.floor(((i + 1) * x.length) / n);
    for (let k = Math.floor((i * x.length) / n); k < end; k++) peaks[i] = Math.max(peaks[i], Math.abs(x[k]));
  }
  const top = Math.max(1e-6, ...peaks);
  return peaks.map(v => v / top);
}
