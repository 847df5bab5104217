// The world in three dimensions, from the shapes in the header and the poses of frames, and the camera's images. Turn with the
// pointer or the arrow keys, zoom with the wheel or plus and minus.

import { run, listen, shownTime, isLive } from '/run.js';

const VERTEX = `attribute vec3 place, normal; uniform mat4 view, model; uniform vec3 size; varying vec3 n; varying vec3 at;
void main() { vec4 world = model * vec4(place * size, 1.0); n = mat3(model) * (normal / size); at = world.xyz; gl_Position = view * world; }`;
const FRAGMENT = `precision mediump float; varying vec3 n; varying vec3 at; uniform vec4 color; uniform float grid;
void main() { float light = 0.45 + 0.55 * max(0.0, dot(normalize(n), normalize(vec3(-0.35, -0.3, 0.9))) * 0.8 + 0.2);
  vec3 c = color.rgb * light; if (grid > 0.5) { vec2 f = abs(fract(at.xy * 2.0) - 0.5); if (max(f.x, f.y) > 0.485) c *= 0.86; } gl_FragColor = vec4(c, color.a); }`;

// Unit shapes: lists of triangles with normals.
function surface(point, normal, rows, columns) {
  const out = [];
  for (let i = 0; i < rows; i++) for (let j = 0; j < columns; j++) {
    const corner = (a, b) => [...point((i + a) / rows, (j + b) / columns), ...normal((i + a) / rows, (j + b) / columns)];
    out.push(...corner(0, 0), ...corner(1, 0), ...corner(1, 1), ...corner(0, 0), ...corner(1, 1), ...corner(0, 1));
  }
  return out;
}
const ring = (v) => [Math.cos(v * 2 * Math.PI), Math.sin(v * 2 * Math.PI)];
const ball = (u, v) => { const s = Math.sin(u * Math.PI); return [s * ring(v)[0], s * ring(v)[1], -Math.cos(u * Math.PI)]; };
const side = (u, v) => [...ring(v), u * 2 - 1];
const disc = (z) => surface((u, v) => [u * ring(v)[0], u * ring(v)[1], z], () => [0, 0, z], 1, 24);
function cube() {
  const out = [];
  for (let axis = 0; axis < 3; axis++) for (const sign of [-1, 1]) {
    const corner = (a, b) => { const p = [0, 0, 0], n = [0, 0, 0]; p[axis] = n[axis] = sign; p[(axis + 1) % 3] = a; p[(axis + 2) % 3] = b; return [...p, ...n]; };
    out.push(...corner(-1, -1), ...corner(1, -1), ...corner(1, 1), ...corner(-1, -1), ...corner(1, 1), ...corner(-1, 1));
  }
  return out;
}
const FORMS = { box: cube(), sphere: surface(ball, ball, 10, 20), tube: surface(side, (u, v) => [...ring(v), 0], 1, 24), cylinder: [...surface(side, (u, v) => [...ring(v), 0], 1, 24), ...disc(1), ...disc(-1)] };

const multiply = (a, b) => { const out = new Float32Array(16); for (let c = 0; c < 4; c++) for (let r = 0; r < 4; r++) for (let k = 0; k < 4; k++) out[c * 4 + r] += a[k * 4 + r] * b[c * 4 + k]; return out; };
const pose = ([x, y, z, a, b, c, w]) => new Float32Array([1 - 2 * (b * b + c * c), 2 * (a * b + c * w), 2 * (a * c - b * w), 0, 2 * (a * b - c * w), 1 - 2 * (a * a + c * c), 2 * (b * c + a * w), 0, 2 * (a * c + b * w), 2 * (b * c - a * w), 1 - 2 * (a * a + b * b), 0, x, y, z, 1]);
const HERE = [0, 0, 0, 0, 0, 0, 1];

export function worldView(panel) {
  panel.innerHTML = `<div class="tools"><h2>World</h2><button type="button" data-do="home">whole</button><button type="button" data-do="images" aria-pressed="true">images</button></div>
    <div class="fill" tabindex="0" role="application" aria-label="The world in three dimensions; arrow keys turn it"><canvas></canvas><div class="pictures"></div></div>`;
  const [fill, canvas, pictures] = [panel.querySelector('.fill'), panel.querySelector('canvas'), panel.querySelector('.pictures')];
  const home = { turn: -0.6, tilt: 0.35, far: 3.2, to: [0.1, 0.35, 0.95] };
  let eye = { ...home }, gl = null, program = null, place = {}, buffers = {}, images = true;

  function begin() {
    gl = canvas.getContext('webgl', { antialias: true, powerPreference: 'low-power' });
    if (!gl) { fill.prepend(Object.assign(document.createElement('p'), { className: 'dim', textContent: 'This browser draws nothing in three dimensions (no WebGL).' })); return; }
    const shader = (kind, source) => { const made = gl.createShader(kind); gl.shaderSource(made, source); gl.compileShader(made); return made; };
    program = gl.createProgram();
    gl.attachShader(program, shader(gl.VERTEX_SHADER, VERTEX)); gl.attachShader(program, shader(gl.FRAGMENT_SHADER, FRAGMENT));
    gl.linkProgram(program); gl.useProgram(program);
    for (const name of ['view', 'model', 'size', 'color', 'grid']) place[name] = gl.getUniformLocation(program, name);
    for (const name of ['place', 'normal']) { place[name] = gl.getAttribLocation(program, name); gl.enableVertexAttribArray(place[name]); }
    for (const [name, form] of Object.entries(FORMS)) buffers[name] = buffer(form);
    gl.enable(gl.DEPTH_TEST);
  }
  function buffer(numbers) { const made = gl.createBuffer(); gl.bindBuffer(gl.ARRAY_BUFFER, made); gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(numbers), gl.STATIC_DRAW); return { made, count: numbers.length / 6 }; }
  function mesh(solid) {
    const out = [];
    for (const corners of solid.triangles) {
      const [a, b, c] = corners.map((at) => solid.vertices[at]), u = b.map((v, i) => v - a[i]), w = c.map((v, i) => v - a[i]);
      const n = [u[1] * w[2] - u[2] * w[1], u[2] * w[0] - u[0] * w[2], u[0] * w[1] - u[1] * w[0]];
      for (const p of [a, b, c]) out.push(...p, ...n);
    }
    return buffer(out);
  }
  function paint(form, model, size, color, grid = 0) {
    gl.bindBuffer(gl.ARRAY_BUFFER, form.made);
    gl.vertexAttribPointer(place.place, 3, gl.FLOAT, false, 24, 0); gl.vertexAttribPointer(place.normal, 3, gl.FLOAT, false, 24, 12);
    gl.uniformMatrix4fv(place.model, false, model); gl.uniform3fv(place.size, size); gl.uniform4f(place.color, color[0] / 255, color[1] / 255, color[2] / 255, 1); gl.uniform1f(place.grid, grid);
    gl.drawArrays(gl.TRIANGLES, 0, form.count);
  }
  function draw() {
    if (panel.hidden || !fill.clientWidth) return;
    if (!gl && !program) { begin(); if (!gl) return; }
    const ratio = Math.min(devicePixelRatio || 1, 1.5), width = Math.round(fill.clientWidth * ratio), height = Math.round(fill.clientHeight * ratio);
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const dark = matchMedia('(prefers-color-scheme: dark)').matches, back = dark ? [0.08, 0.094, 0.1] : [0.93, 0.94, 0.935];
    gl.viewport(0, 0, width, height); gl.clearColor(...back, 1); gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniformMatrix4fv(place.view, false, camera(width / height));
    paint(buffers.box, pose([0, 0, -0.01, 0, 0, 0, 1]), [3, 3, 0.01], dark ? [52, 58, 56] : [205, 210, 206], 1);
    for (const solid of run.header.solids ?? []) {
      const at = solid.frame ? run.shown[solid.frame] : HERE;
      // Somebody who comes and goes is there while he was seen a moment ago.
      if (!at || solid.passing && Math.abs(shownTime() - at[7]) > 0.5) continue;
      const model = multiply(pose(at), pose(solid.at ?? HERE)), { size } = solid;
      if (solid.form === 'box') paint(buffers.box, model, size.map((edge) => edge / 2), solid.color);
      else if (solid.form === 'sphere') paint(buffers.sphere, model, [size[0], size[0], size[0]], solid.color);
      else if (solid.form === 'cylinder') paint(buffers.cylinder, model, [size[0], size[0], size[1] / 2], solid.color);
      else if (solid.form === 'capsule') {
        const [radius, length] = size, end = (z) => multiply(model, pose([0, 0, z, 0, 0, 0, 1]));
        paint(buffers.tube, model, [radius, radius, length / 2], solid.color);
        for (const z of [-length / 2, length / 2]) paint(buffers.sphere, end(z), [radius, radius, radius], solid.color);
      } else if (solid.form === 'mesh') paint(solid.buffer ??= mesh(solid), model, [1, 1, 1], solid.color);
    }
  }
  function camera(aspect) {
    const { turn, tilt, far, to } = eye, f = 1 / Math.tan(0.4), [near, most] = [0.05, 30];
    const back = [Math.cos(tilt) * Math.sin(turn), -Math.cos(tilt) * Math.cos(turn), Math.sin(tilt)];
    const from = to.map((v, i) => v + back[i] * far), x = [Math.cos(turn), Math.sin(turn), 0];
    const y = [back[1] * x[2] - back[2] * x[1], back[2] * x[0] - back[0] * x[2], back[0] * x[1] - back[1] * x[0]];
    const dot = (a) => -(a[0] * from[0] + a[1] * from[1] + a[2] * from[2]);
    const look = new Float32Array([x[0], y[0], back[0], 0, x[1], y[1], back[1], 0, x[2], y[2], back[2], 0, dot(x), dot(y), dot(back), 1]);
    const lens = new Float32Array([f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (most + near) / (near - most), -1, 0, 0, 2 * most * near / (near - most), 0]);
    return multiply(lens, look);
  }
  let due = false;
  const later = () => { if (!due) { due = true; requestAnimationFrame(() => { due = false; draw(); }); } };
  let from = null;
  fill.onpointerdown = (event) => { from = event; fill.setPointerCapture(event.pointerId); };
  fill.onpointermove = (event) => {
    if (!from) return;
    const [dx, dy] = [event.clientX - from.clientX, event.clientY - from.clientY]; from = event;
    if (event.shiftKey || event.buttons === 4) {
      const step = eye.far / fill.clientHeight;
      eye.to = [eye.to[0] - dx * step * Math.cos(eye.turn), eye.to[1] - dx * step * Math.sin(eye.turn), eye.to[2] + dy * step];
    } else { eye.turn -= dx * 0.008; eye.tilt = Math.max(-0.2, Math.min(1.55, eye.tilt + dy * 0.006)); }
    later();
  };
  fill.onpointerup = () => { from = null; };
  const zoom = (factor) => { eye.far = Math.max(0.3, Math.min(12, eye.far * factor)); later(); };
  fill.addEventListener('wheel', (event) => { event.preventDefault(); zoom(Math.exp(event.deltaY * 0.001)); }, { passive: false });
  fill.onkeydown = (event) => {
    const keys = { ArrowLeft: () => { eye.turn -= 0.15; }, ArrowRight: () => { eye.turn += 0.15; }, ArrowUp: () => { eye.tilt = Math.min(1.55, eye.tilt + 0.1); }, ArrowDown: () => { eye.tilt = Math.max(-0.2, eye.tilt - 0.1); }, '+': () => zoom(0.8), '-': () => zoom(1.25) };
    if (keys[event.key]) { keys[event.key](); event.preventDefault(); later(); }
  };
  panel.querySelector('.tools').onclick = ({ target }) => {
    if (target.dataset.do === 'home') eye = { ...home };
    if (target.dataset.do === 'images') { images = !images; target.setAttribute('aria-pressed', images); look(true); }
    later();
  };

  // The camera's images, as the recording has them.
  let looked = -Infinity;
  async function look(force) {
    if (panel.hidden || (!force && performance.now() - looked < 200)) return;
    looked = performance.now();
    pictures.hidden = !images;
    if (!images) return;
    if (isLive() && !run.images.length && run.now > 0) { try { run.images = (await (await fetch('images')).json()); } catch { return; } }
    for (const topic of run.images) {
      let figure = [...pictures.children].find((each) => each.dataset.topic === topic);
      if (!figure) {
        figure = document.createElement('figure'); figure.dataset.topic = topic;
        figure.append(Object.assign(document.createElement('img'), { alt: `What ${topic} saw` }), document.createElement('figcaption')); pictures.append(figure);
      }
      try {
        const answer = await fetch(`image?${new URLSearchParams(isLive() ? { topic } : { topic, t: shownTime() })}`);
        if (!answer.ok) continue;
        const stamp = answer.headers.get('x-about');
        if (figure.dataset.stamp === stamp) continue;
        const [image, old] = [figure.querySelector('img'), figure.querySelector('img').src];
        figure.dataset.stamp = stamp; image.src = URL.createObjectURL(await answer.blob());
        if (old.startsWith('blob:')) URL.revokeObjectURL(old);
        figure.querySelector('figcaption').textContent = `${topic}, ${(stamp * 1e-9).toFixed(1)} s`;
      } catch { return; }
    }
  }
  new ResizeObserver(later).observe(fill);
  window.addEventListener('resize', () => { later(); look(false); });
  listen(() => { later(); look(false); });
}
