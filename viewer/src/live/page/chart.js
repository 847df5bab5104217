// The chart: the picture of `armarium graph`, with what is active lit. Zoom, move, search, fold, and what a state is.

import { run, listen, shownTime, activeAt, isLeaf, isLive, showTime, act } from '/run.js';
import { inWords } from '/words.js';

const text = (tag, content, more = {}) => Object.assign(document.createElement(tag), { textContent: content }, more);
const value = (data) => text('code', inWords(data));

export function chartView(panel) {
  panel.innerHTML = `<div class="tools"><h2>Chart</h2><input type="search" placeholder="find a state" aria-label="Find a state">
    <button type="button" data-do="less" title="Fold all but the outermost states">fold</button><button type="button" data-do="more">unfold</button>
    <button type="button" data-do="fit">fit</button><button type="button" data-do="follow" aria-pressed="false" title="Keep what is active in view">follow</button></div>
    <div class="fill chart" tabindex="0" role="application" aria-label="The chart; arrow keys move it, plus and minus zoom"></div><aside class="detail" hidden></aside>`;
  const [field, detail, search] = [panel.querySelector('.chart'), panel.querySelector('.detail'), panel.querySelector('input')];
  const view = { x: 0, y: 0, zoom: 1 };
  let svg = null, boxes = new Map(), closed = null, chosen = null, fitted = false, stops = new Set(), follows = false, before = new Set();

  async function draw() {
    const query = closed === null ? '' : `?closed=${encodeURIComponent([...closed].join(','))}`;
    const answer = await fetch(`chart${query}`);
    if (!answer.ok) { field.replaceChildren(text('p', await answer.text(), { className: 'dim' })); return; }
    if (closed === null) closed = new Set((answer.headers.get('x-about') ?? '').split(',').filter(Boolean));
    field.innerHTML = await answer.text();
    svg = field.querySelector('svg');
    svg.setAttribute('role', 'group');
    boxes = new Map([...svg.querySelectorAll('[data-state]')].map((box) => [box.dataset.state, box]));
    for (const [path, box] of boxes) {
      box.setAttribute('tabindex', '0'); box.setAttribute('role', 'button'); box.setAttribute('aria-label', `state ${path || 'the chart'}`);
      box.onclick = (event) => { if (!moved) choose(path, event); };
      box.ondblclick = () => toggle(path);
      box.onkeydown = ({ key }) => { if (key === 'Enter') choose(path); };
    }
    if (!fitted) fit(); else place();
    light(true); find();
  }
  function toggle(path) {
    if (closed.has(path)) closed.delete(path); else closed.add(path);
    draw();
  }
  function fit() {
    if (!svg || !field.clientWidth) return;
    const [width, height] = [svg.width.baseVal.value, svg.height.baseVal.value];
    view.zoom = Math.min(field.clientWidth / width, field.clientHeight / height, 1.5);
    Object.assign(view, { x: (field.clientWidth - width * view.zoom) / 2, y: (field.clientHeight - height * view.zoom) / 2 });
    fitted = true; place();
  }
  const place = () => { if (svg) svg.style.transform = `translate(${view.x}px,${view.y}px) scale(${view.zoom})`; };
  function zoom(factor, x = field.clientWidth / 2, y = field.clientHeight / 2) {
    const to = Math.max(0.05, Math.min(8, view.zoom * factor));
    view.x = x - (x - view.x) * to / view.zoom; view.y = y - (y - view.y) * to / view.zoom; view.zoom = to;
    follows = false; place();
  }
  function center(path) {
    const box = boxes.get(path);
    if (!box) return;
    const { x, y, width, height } = box.getBBox();
    const least = Math.min(1, field.clientWidth / (width * 1.3), field.clientHeight / (height * 1.3));
    view.zoom = Math.max(view.zoom, Math.min(least, 0.8));
    view.x = field.clientWidth / 2 - (x + width / 2) * view.zoom; view.y = field.clientHeight / 2 - (y + height / 2) * view.zoom;
    place();
  }
  // A state that is not shown lies in one that is folded.
  const shownBox = (path) => { for (let at = path; ; at = at.slice(0, Math.max(0, at.lastIndexOf('.')))) { if (boxes.has(at)) return at; if (!at) return null; } };

  let since = 0;
  function light(force = false) {
    if (!svg) return;
    const states = activeAt(shownTime()), lit = new Set(), leaves = new Set();
    for (const state of states.keys()) { const at = shownBox(state); if (at !== null) { lit.add(at); if (isLeaf(state, states)) leaves.add(at); } }
    for (const [path, box] of boxes) {
      box.classList.toggle('active', lit.has(path)); box.classList.toggle('leaf', leaves.has(path));
      box.classList.toggle('just', lit.has(path) && !before.has(path) && !force);
      box.classList.toggle('stop', stops.has(path)); box.classList.toggle('chosen', path === chosen);
      box.classList.toggle('failed', Boolean(run.ended) && run.ended.outcome !== 'success' && (run.ended.chain ?? []).some((state) => shownBox(state) === path));
      if (box.getAttribute('aria-current') !== String(lit.has(path))) box.setAttribute('aria-current', lit.has(path));
    }
    if (follows) { const leaf = [...leaves].find((path) => path && !before.has(path)); if (leaf) center(leaf); }
    before = lit;
    clocks(states, leaves, force);
  }
  // How long each innermost state has been active.
  function clocks(states, leaves, force) {
    const now = performance.now();
    if (!force && now - since < 200) return;
    since = now;
    svg.querySelectorAll('.since').forEach((old) => old.remove());
    for (const path of leaves) {
      const box = boxes.get(path), from = states.get(path);
      if (!box || from === undefined || !path) continue;
      const { x, y, width } = box.getBBox(), make = (tag, set, content = '') => {
        const made = document.createElementNS('http://www.w3.org/2000/svg', tag);
        Object.entries(set).forEach(([name, to]) => made.setAttribute(name, to));
        made.textContent = content; svg.append(made); return made;
      };
      // On the upper edge of the box, where nothing is written.
      const words = `${(shownTime() - from).toFixed(1)} s`, wide = words.length * 6.4 + 8, right = x + width - 6;
      make('rect', { x: right - wide, y: y - 8, width: wide, height: 15, rx: 7, class: 'since back' });
      make('text', { x: right - wide / 2, y: y + 3, 'text-anchor': 'middle', class: 'since' }, words);
    }
  }

  function choose(path) {
    chosen = path; light(true); describe();
  }
  function describe() {
    if (chosen === null) { detail.hidden = true; return; }
    const path = chosen, state = run.header.states?.[path] ?? {}, now = shownTime();
    const close = text('button', 'close', { type: 'button', onclick: () => { chosen = null; light(true); describe(); } });
    const parts = [close, text('h2', path || run.header.title || 'the chart')];
    if (state.description) parts.push(text('p', state.description));
    const actions = text('div', '', { className: 'tools' });
    if (state.inside) actions.append(text('button', closed.has(path) ? 'unfold' : 'fold', { type: 'button', onclick: () => toggle(path) }));
    if (run.token && path) actions.append(text('button', stops.has(path) ? 'no breakpoint' : 'breakpoint', { type: 'button', onclick: () => {
      if (stops.has(path)) stops.delete(path); else stops.add(path);
      act({ do: 'breakpoints', states: [...stops] }); light(true); describe();
    } }));
    if (actions.children.length) parts.push(actions);
    const visits = run.spans.filter((span) => span.state === path && span.from <= now);
    parts.push(text('h3', `visits: ${visits.length}`));
    const table = document.createElement('table');
    for (const span of visits.slice(-20).reverse()) {
      const row = table.insertRow();
      row.insertCell().append(text('button', `${span.from.toFixed(2)} s`, { type: 'button', onclick: () => showTime(span.from) }));
      const until = span.to !== null && span.to <= now ? span.to : null;
      row.insertCell().textContent = until === null ? 'active' : `${(until - span.from).toFixed(2)} s`;
      row.insertCell().textContent = until === null ? '' : span.outcome ?? '';
    }
    parts.push(table);
    const started = run.events.findLast(({ time, item }) => time <= now && item.what === 'skill_started' && item.state === path);
    const ended = run.events.findLast(({ time, item }) => time <= now && item.what === 'skill_ended' && item.state === path);
    const skill = run.header.skills?.[started?.item.skill ?? state.skill];
    if (skill) parts.push(text('h3', `skill ${skill.name}`), text('p', skill.description));
    const list = (title, values, declared) => {
      if (!values || !Object.keys(values).length) return;
      const rows = document.createElement('table');
      for (const [name, data] of Object.entries(values)) {
        const row = rows.insertRow(), about = declared?.find((each) => each.name === name);
        row.insertCell().append(text('span', name, { title: about?.description ?? '' }));
        row.insertCell().append(value(data)); row.insertCell().textContent = about?.type ?? '';
      }
      parts.push(text('h3', title), rows);
    };
    // Somebody may end a skill that runs, as if it had come to that outcome.
    if (run.token && skill && isLive() && started && !(ended?.item.activation >= started.item.activation)) {
      const choice = text('div', '', { className: 'tools' });
      for (const outcome of ['success', ...(skill.outcomes ?? []), 'failure']) {
        choice.append(text('button', outcome, { type: 'button', title: `cancel the skill, and go on as after ${outcome}`, onclick: () => act({ do: 'outcome', state: path, outcome }) }));
      }
      parts.push(text('h3', 'end it with'), choice);
    }
    list('inputs', started?.item.inputs, skill?.inputs);
    list('outputs', ended && (!started || ended.item.activation >= started.item.activation) ? ended.item.outputs : null, skill?.outputs);
    if (ended?.item.reason) parts.push(text('h3', 'reason'), text('p', ended.item.reason));
    const locals = {};
    for (const { time, item } of run.events) if (time <= now && item.what === 'assigned') locals[item.variable] = item.value;
    if (!path) list('variables', locals);
    list('written', state.written && { is: state.written });
    detail.replaceChildren(...parts); detail.hidden = false;
  }
  function find() {
    const sought = search.value.trim().toLowerCase();
    for (const [path, box] of boxes) box.classList.toggle('found', sought !== '' && path.toLowerCase().includes(sought));
  }
  search.oninput = () => {
    const sought = search.value.trim().toLowerCase();
    if (!sought) return find();
    const hit = Object.keys(run.header.states ?? {}).find((path) => path.toLowerCase().includes(sought));
    if (hit === undefined) return find();
    // What is folded around it is unfolded.
    const around = hit.split('.').slice(0, -1).map((_, at, parts) => parts.slice(0, at + 1).join('.'));
    const opens = [...around, ''].filter((path) => closed?.has(path));
    opens.forEach((path) => closed.delete(path));
    (opens.length ? draw() : Promise.resolve()).then(() => { find(); center(hit); });
  };

  let moved = false, from = null;
  const fingers = new Map();
  field.onpointerdown = (event) => { fingers.set(event.pointerId, event); from = { x: event.clientX - view.x, y: event.clientY - view.y }; moved = false; };
  field.onpointermove = (event) => {
    if (!fingers.has(event.pointerId)) return;
    const last = fingers.get(event.pointerId); fingers.set(event.pointerId, event);
    if (fingers.size === 2) {
      const [a, b] = [...fingers.values()], other = a.pointerId === event.pointerId ? b : a, at = field.getBoundingClientRect();
      const apart = (one) => Math.hypot(one.clientX - other.clientX, one.clientY - other.clientY);
      zoom(apart(event) / Math.max(1, apart(last)), (event.clientX + other.clientX) / 2 - at.x, (event.clientY + other.clientY) / 2 - at.y);
      moved = true;
    } else if (Math.hypot(event.clientX - from.x - view.x, event.clientY - from.y - view.y) > 4 || moved) {
      moved = true; follows = false; Object.assign(view, { x: event.clientX - from.x, y: event.clientY - from.y }); place();
    }
  };
  const up = (event) => fingers.delete(event.pointerId);
  Object.assign(field, { onpointerup: up, onpointercancel: up, onpointerleave: up });
  field.addEventListener('wheel', (event) => {
    event.preventDefault();
    const at = field.getBoundingClientRect();
    zoom(Math.exp(-event.deltaY * 0.0015), event.clientX - at.x, event.clientY - at.y);
  }, { passive: false });
  field.onkeydown = (event) => {
    const keys = { ArrowLeft: () => { view.x += 60; place(); }, ArrowRight: () => { view.x -= 60; place(); }, ArrowUp: () => { view.y += 60; place(); },
      ArrowDown: () => { view.y -= 60; place(); }, '+': () => zoom(1.25), '-': () => zoom(0.8), 0: fit };
    if (event.target === field && keys[event.key]) { keys[event.key](); event.preventDefault(); }
  };
  panel.querySelector('.tools').onclick = ({ target }) => {
    const inside = () => Object.entries(run.header.states ?? {}).filter(([path, state]) => path && state.inside).map(([path]) => path);
    ({ less: () => { closed = new Set(inside()); fitted = false; draw(); }, more: () => { closed = new Set(); fitted = false; draw(); }, fit,
      follow: () => { follows = !follows; } })[target.dataset.do]?.();
    panel.querySelector('[data-do=follow]').setAttribute('aria-pressed', follows);
  };
  new ResizeObserver(() => { if (!fitted || !moved) fit(); }).observe(field);
  listen((what) => {
    if (what.has('all') && run.header.states) { if (!svg) draw(); else light(true); describe(); }
    if (what.has('events') || what.has('cursor') || what.has('ended')) { light(); describe(); } else if (what.has('time')) light();
  });
}
