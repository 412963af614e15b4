// Draws skins by WebGL 2 into a picture of its own, which is laid over the stage.
import { channels } from './body.js';
import { make, model, on } from './data.js';
import { grow } from './skin.js';
import { camera, state } from './state.js';

const SKINNED = `#version 300 es
precision highp float;in vec3 at,normal;in uvec4 bones;in vec4 weights;in vec4 tint;uniform vec4 rows[192];
uniform mat4 see;out vec3 n,w,t;void main(){vec3 p=vec3(0),q=vec3(0);float all=0.;vec4 h=vec4(at,1);
for(int k=0;k<4;k++){float s=weights[k];int b=int(bones[k])*3;vec4 x=rows[b],y=rows[b+1],z=rows[b+2];
p+=s*vec3(dot(x,h),dot(y,h),dot(z,h));q+=s*vec3(dot(x.xyz,normal),dot(y.xyz,normal),dot(z.xyz,normal));all+=s;}
w=p/all;n=q;t=tint.xyz;gl_Position=see*vec4(w,1);}`;
const LIT = `#version 300 es
precision highp float;in vec3 n,w,t;uniform vec3 eye,key,tones[4];uniform float floorY;out vec4 o;void main(){
vec3 m=normalize(n),v=normalize(eye-w);vec3 c=mix(tones[0]*(1.-t.x-t.y)+tones[1]*t.x+tones[2]*t.y,tones[3],smoothstep(.3,.6,t.z));
float d=max(0.,dot(m,key)*.6+.4),low=smoothstep(0.,.5,w.y-floorY);
float rim=pow(1.-max(0.,dot(m,v)),3.),shine=pow(max(0.,dot(m,normalize(key+v))),34.);
o=vec4(c*(d*.74+mix(.2,.36,.5+.5*m.y)*mix(.65,1.,low))+rim*.12+shine*.12,1);}`;
const DARK = `#version 300 es
precision highp float;in vec3 n,w,t;uniform float floorY;out vec4 o;void main(){o=vec4(exp(-max(0.,w.y-floorY)*3.2));}`;
const GROUND = `#version 300 es
precision highp float;in vec2 at;uniform mat4 see;uniform vec3 middle;out vec2 g;void main(){g=at;
gl_Position=see*vec4(middle+vec3(at.x,0,at.y)*1.6,1);}`;
const SHADE = `#version 300 es
precision highp float;in vec2 g;uniform sampler2D dark;uniform vec3 shade;out vec4 o;void main(){float s=0.;
for(int i=0;i<32;i++){float a=float(i)*2.4;s+=texture(dark,g*.5+.5+sqrt(float(i)+.5)*.0045*vec2(cos(a),sin(a))).r;}
float k=min(.85,s/30.);o=vec4(shade*k,k);}`;
const ATTRIBUTES = ['at', 'normal', 'bones', 'weights', 'tint'];
const SOFTWARE = /swiftshader|llvmpipe|softpipe|software|basic render/i;
// Side of the picture of the body from above, pixels, and pictures that decide whether it is drawn fast enough.
const ABOVE = 256;
const MEASURED = 20;

let gl = null;
// What was tried: a fast renderer, and any.
const tried = new Set();
let programs = null;
const grown = new Map();
const spans = [];

function programOf(vertex, fragment) {
  const p = gl.createProgram();
  for (const [kind, text] of [
    [gl.VERTEX_SHADER, vertex],
    [gl.FRAGMENT_SHADER, fragment],
  ]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(p, shader);
  }
  for (const [k, name] of ATTRIBUTES.entries()) gl.bindAttribLocation(p, k, name);
  gl.linkProgram(p);
  if (!gl.getProgramParameter(p, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(p));
  const uniforms = {};
  return { p, at: name => (uniforms[name] ??= gl.getUniformLocation(p, name)) };
}

function attribute(k, data, size, type, whole) {
  const buffer = gl.createBuffer();
  gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
  gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
  gl.enableVertexAttribArray(k);
  if (whole) gl.vertexAttribIPointer(k, size, type, 0, 0);
  else gl.vertexAttribPointer(k, size, type, type === gl.UNSIGNED_BYTE, 0, 0);
  return buffer;
}

function start(slowly) {
  if (gl || tried.has(slowly)) return;
  tried.add(slowly);
  const picture = make('canvas');
  gl = picture.getContext('webgl2', { antialias: true, failIfMajorPerformanceCaveat: !slowly });
  if (!gl) return;
  on(picture, 'webglcontextlost', () => {
    gl = null;
    grown.clear();
    state.dirty = true;
  });
  try {
    programs = {
      lit: programOf(SKINNED, LIT),
      dark: programOf(SKINNED, DARK),
      ground: programOf(GROUND, SHADE),
      plane: gl.createVertexArray(),
      above: gl.createTexture(),
      frame: gl.createFramebuffer(),
    };
  } catch (_error) {
    gl = null;
    return;
  }
  gl.bindVertexArray(programs.plane);
  attribute(0, new Float32Array([-1, -1, 1, -1, -1, 1, 1, 1]), 2, gl.FLOAT);
  gl.bindTexture(gl.TEXTURE_2D, programs.above);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.R8, ABOVE, ABOVE, 0, gl.RED, gl.UNSIGNED_BYTE, null);
  for (const k of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, k, gl.LINEAR);
  for (const k of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, k, gl.CLAMP_TO_EDGE);
  gl.bindFramebuffer(gl.FRAMEBUFFER, programs.frame);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, programs.above, 0);
}

// Whether skins can be drawn; by software only if they may be slow.
export function canSkin(slowly) {
  start(slowly);
  if (!gl || slowly) return !!gl;
  const info = gl.getExtension('WEBGL_debug_renderer_info');
  return !SOFTWARE.test(info ? gl.getParameter(info.UNMASKED_RENDERER_WEBGL) : '');
}

// The mesh of a figure on the graphics card; figures of one body share it.
function meshOf(figure) {
  const key = figure.model ? 'model' : `${figure.joints} ${figure.turns.rest}`;
  if (!grown.has(key)) {
    const mesh = figure.model ? model : grow(figure);
    const vertices = gl.createVertexArray();
    gl.bindVertexArray(vertices);
    const buffers = [
      attribute(0, mesh.at, 3, gl.FLOAT),
      attribute(1, mesh.normal, 3, gl.FLOAT),
      attribute(2, mesh.bones, 4, gl.UNSIGNED_BYTE, true),
      attribute(3, mesh.weights, 4, gl.UNSIGNED_BYTE),
      attribute(4, mesh.tint, 4, gl.UNSIGNED_BYTE),
      gl.createBuffer(),
    ];
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffers[5]);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, mesh.faces, gl.STATIC_DRAW);
    grown.set(key, { vertices, buffers, indices: mesh.faces.length });
    if (grown.size > 16) forget(grown.keys().next().value);
  }
  const found = grown.get(key);
  grown.delete(key);
  grown.set(key, found); // as the one that was drawn last
  return found;
}

function forget(key) {
  const { vertices, buffers } = grown.get(key);
  gl.deleteVertexArray(vertices);
  for (const buffer of buffers) gl.deleteBuffer(buffer);
  grown.delete(key);
}

const world = new Float32Array(9 * 64);
const placing = new Float32Array(12 * 64);

function quaternion(turning, i, unit) {
  const [x, y, z] = [turning[i] * unit, turning[i + 1] * unit, turning[i + 2] * unit];
  const angle = Math.hypot(x, y, z);
  const s = angle > 1e-6 ? Math.sin(angle / 2) / angle : 0.5;
  return [x * s, y * s, z * s, Math.cos(angle / 2)];
}

// Three rows of a matrix a joint, from its rest pose to its place; of a mirrored dancer with `swap`.
export function rowsOf(figure, places, t, shift, swap) {
  const { rest, unit } = figure.turns;
  const at = Math.max(0, Math.min(figure.frames - 1, t * figure.rate));
  const i = Math.floor(at);
  const next = Math.min(figure.frames - 1, i + 1);
  for (let j = 0; j < figure.count; j++) {
    const from = 3 * (swap ? figure.mirror[j] : j);
    const a = quaternion(figure.turning, i * figure.width + from, unit);
    const b = quaternion(figure.turning, next * figure.width + from, unit);
    const sign = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] < 0 ? i - at : at - i;
    const q = a.map((v, k) => v * (1 - at + i) + b[k] * sign);
    const long = Math.hypot(...q);
    let [x, y, z, w] = q.map(v => v / long);
    if (swap) [y, z] = [-y, -z];
    const m = [
      1 - 2 * (y * y + z * z),
      2 * (x * y - z * w),
      2 * (x * z + y * w),
      2 * (x * y + z * w),
      1 - 2 * (x * x + z * z),
      2 * (y * z - x * w),
      2 * (x * z - y * w),
      2 * (y * z + x * w),
      1 - 2 * (x * x + y * y),
    ];
    const p = 9 * figure.parents[j];
    for (let r = 0; r < 9; r += 3)
      for (let c = 0; c < 3; c++)
        world[9 * j + r + c] =
          p < 0 ? m[r + c] : world[p + r] * m[c] + world[p + r + 1] * m[3 + c] + world[p + r + 2] * m[6 + c];
    const moved = [shift[0], 0, shift[1]];
    for (let r = 0; r < 3; r++) {
      const o = 12 * j + 4 * r;
      let d = places[3 * j + r] + moved[r];
      for (let c = 0; c < 3; c++) {
        placing[o + c] = world[9 * j + 3 * r + c];
        d -= placing[o + c] * rest[3 * j + c];
      }
      placing[o + 3] = d;
    }
  }
  return placing;
}

// The view of the stage's own projection: columns of a matrix, the eye and the light.
function viewOf(w, h, far) {
  const [cy, sy, cp, sp] = [
    Math.cos(camera.yaw),
    Math.sin(camera.yaw),
    Math.cos(camera.pitch),
    Math.sin(camera.pitch),
  ];
  const right = [cy, 0, -sy];
  const up = [-sy * sp, cp, -cy * sp];
  const back = [sy * cp, sp, cy * cp];
  const eye = [camera.x, camera.y, camera.z].map((v, k) => v + back[k] * far);
  const row = (a, b, by) => [...a.map((v, k) => v * b - back[k] * by), 0];
  const depth = [...back.map(v => -v), 0];
  const x = row(right, (2.5 * h) / w, (2 * h * camera.right) / w);
  const y = row(up, 2.5, -2 * camera.up);
  const z = depth.map(v => v * 1.001);
  const lines = [x, y, z, depth];
  for (const line of lines) line[3] = -(line[0] * eye[0] + line[1] * eye[1] + line[2] * eye[2]);
  z[3] -= 0.1;
  const key = right.map((v, k) => 0.42 * v + 0.75 * up[k] + 0.5 * back[k]);
  return { eye, key, see: new Float32Array([0, 1, 2, 3].flatMap(c => lines.map(line => line[c]))) };
}

function bind(program, see, floor) {
  gl.useProgram(program.p);
  gl.uniform4fv(program.at('rows[0]'), placing);
  gl.uniformMatrix4fv(program.at('see'), false, see);
  gl.uniform1f(program.at('floorY'), floor);
}

const rgb = colour => channels(colour).map(v => v / 255);

function begin(pen) {
  const { width, height } = pen.canvas;
  if (gl.canvas.width !== width || gl.canvas.height !== height) Object.assign(gl.canvas, { width, height });
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  gl.viewport(0, 0, width, height);
  gl.disable(gl.BLEND);
  gl.enable(gl.DEPTH_TEST);
  gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
}

// `tones`: middle, left, right, face.
export function drawSkin(pen, figure, far, tones, alpha) {
  const { width, height } = pen.canvas;
  const mesh = meshOf(figure);
  begin(pen);
  const { see, eye, key } = viewOf(width, height, far);
  bind(programs.lit, see, figure.floor);
  gl.uniform3fv(programs.lit.at('eye'), eye);
  gl.uniform3fv(programs.lit.at('key'), key);
  gl.uniform3fv(programs.lit.at('tones[0]'), tones.flatMap(rgb));
  gl.bindVertexArray(mesh.vertices);
  gl.drawElements(gl.TRIANGLES, mesh.indices, gl.UNSIGNED_INT, 0);
  pen.globalAlpha = alpha;
  pen.drawImage(gl.canvas, 0, 0);
  pen.globalAlpha = 1;
}

// The shadow on the floor: the body as seen from above, the darker the lower it is.
export function drawSkinShadow(pen, figure, far, colour, alpha) {
  const mesh = meshOf(figure);
  const s = 1 / 1.6;
  const [x, z] = [placing[3], placing[11]]; // the root's, which is at 0 at rest
  gl.bindFramebuffer(gl.FRAMEBUFFER, programs.frame);
  gl.viewport(0, 0, ABOVE, ABOVE);
  gl.disable(gl.DEPTH_TEST);
  gl.enable(gl.BLEND);
  gl.blendEquation(gl.MAX);
  gl.clear(gl.COLOR_BUFFER_BIT);
  bind(programs.dark, new Float32Array([s, 0, 0, 0, 0, 0, 0.01, 0, 0, s, 0, 0, -x * s, -z * s, 0, 1]), figure.floor);
  gl.bindVertexArray(mesh.vertices);
  gl.drawElements(gl.TRIANGLES, mesh.indices, gl.UNSIGNED_INT, 0);
  begin(pen);
  gl.useProgram(programs.ground.p);
  gl.uniformMatrix4fv(programs.ground.at('see'), false, viewOf(pen.canvas.width, pen.canvas.height, far).see);
  gl.uniform3f(programs.ground.at('middle'), x, figure.floor, z);
  gl.uniform3fv(programs.ground.at('shade'), rgb(colour));
  gl.bindVertexArray(programs.plane);
  gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
  pen.globalAlpha = alpha;
  pen.drawImage(gl.canvas, 0, 0);
  pen.globalAlpha = 1;
}

// The picture that skins are drawn in; undefined where they cannot be.
export const skinPicture = () => gl?.canvas;

// Whether skins are given up: the graphics card was taken away, or pictures come too slowly, by the median of the first
// ones while it plays. Asked before each picture.
export function givesUp(now) {
  if (tried.size && !gl) return true;
  if (spans.length > MEASURED || state.bodyChosen || !state.playing) return false;
  spans.push(now);
  if (spans.length <= MEASURED) return false;
  const between = spans.slice(1).map((v, k) => v - spans[k]);
  return between.sort((a, b) => a - b)[MEASURED / 2] > 40;
}
