// The frame of the page: views beside each other or one at a time, the line of time, what is said to screen readers.

import { run, listen, connect, showTime, shownTime, isLive, activeAt, isLeaf, act } from '/run.js';
import { chartView } from '/chart.js';
import { timeView } from '/time.js';
import { worldView } from '/world.js';
import { memoryView } from '/memory.js';
import { reportView } from '/report.js';

const $ = (id) => document.getElementById(id);
const VIEWS = { chart: chartView, world: worldView, time: timeView, memory: memoryView, report: reportView };
const TOGETHER = ['chart', 'world', 'time', 'memory'];
let front = 'overview';

const panels = {};
for (const [name, make] of Object.entries(VIEWS)) {
  const panel = document.createElement('section');
  Object.assign(panel, { className: 'view', id: `view-${name}` });
  panel.dataset.view = name;
  panel.setAttribute('role', 'tabpanel');
  panel.setAttribute('aria-label', name);
  $('views').append(panel);
  panels[name] = panel;
  make(panel);
}
for (const name of ['overview', ...Object.keys(VIEWS)]) {
  const tab = Object.assign(document.createElement('button'), { type: 'button', textContent: name, id: `tab-${name}` });
  tab.setAttribute('role', 'tab');
  tab.onclick = () => show(name);
  tab.onkeydown = ({ key }) => {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[key], tabs = [...$('tabs').children];
    if (step) { const next = tabs[(tabs.indexOf(tab) + step + tabs.length) % tabs.length]; next.focus(); next.click(); }
  };
  $('tabs').append(tab);
}

function show(name) {
  front = name;
  const together = name === 'overview';
  $('views').classList.toggle('one', !together);
  for (const [each, panel] of Object.entries(panels)) {
    panel.hidden = together ? !TOGETHER.includes(each) : each !== name;
    panel.classList.toggle('front', together ? each === 'chart' : each === name);
  }
  for (const tab of $('tabs').children) { const on = tab.id === `tab-${name}`; tab.setAttribute('aria-selected', on); tab.tabIndex = on ? 0 : -1; }
  location.hash = name;
  window.dispatchEvent(new Event('resize'));
}

const transitions = () => run.events.filter((event) => event.item.what === 'transition').map((event) => event.time);
export function jump(step) {
  const times = transitions(), now = shownTime();
  const to = step > 0 ? times.find((time) => time > now + 1e-6) : times.findLast((time) => time < now - 1e-6);
  if (to !== undefined) showTime(to); else if (step > 0) showTime(run.ended ? run.now : null);
}

let playing = null;
function play() {
  if (playing !== null) { cancelAnimationFrame(playing); playing = null; return drawPlayer(); }
  if (isLive() || run.cursor >= run.now) showTime(0);
  let before = performance.now();
  const frame = (at) => {
    const time = shownTime() + (at - before) / 1000 * Number($('speed').value);
    before = at;
    showTime(time);
    if (isLive() || run.cursor >= run.now) { playing = null; return drawPlayer(); }
    playing = requestAnimationFrame(frame);
  };
  playing = requestAnimationFrame(frame);
  drawPlayer();
}
$('play').onclick = play;
$('back').onclick = () => jump(-1);
$('next').onclick = () => jump(1);
$('live').onclick = () => showTime(null);
$('scrub').oninput = ({ target }) => showTime(Number(target.value));
document.addEventListener('keydown', (event) => {
  if (event.target.matches('input, select, textarea') || event.ctrlKey || event.metaKey || event.altKey) return;
  const keys = { ' ': () => play(), ',': () => jump(-1), '.': () => jump(1), End: () => showTime(null), Home: () => showTime(0),
    1: () => show('overview'), 2: () => show('chart'), 3: () => show('world'), 4: () => show('time'), 5: () => show('memory'), 6: () => show('report') };
  if (event.key === ' ' && event.target.matches('button')) return;
  if (keys[event.key]) { keys[event.key](); event.preventDefault(); }
});

function drawPlayer() {
  const time = shownTime();
  Object.assign($('scrub'), { max: Math.max(run.now, 0.001), value: time });
  $('scrub').setAttribute('aria-valuetext', `${time.toFixed(1)} seconds`);
  $('clock').textContent = `${time.toFixed(1)} s`;
  $('play').textContent = playing === null ? '▶' : '⏸';
  $('play').setAttribute('aria-label', playing === null ? 'Play' : 'Stand still');
  $('live').textContent = run.ended ? 'end' : 'newest';
  $('live').setAttribute('aria-pressed', isLive());
}

// The charts that others have started, where there are some.
const own = Number(location.pathname.match(/^\/runs\/(\d+)\//)?.[1] ?? 0);
$('runs').onchange = ({ target }) => { location.href = target.value === '0' ? '/' : `/runs/${target.value}/`; };
async function listRuns() {
  const runs = window.parent === window ? await fetch('/runs').then((answer) => answer.json()).catch(() => []) : [];
  $('runs').hidden = runs.length < 2;
  const key = JSON.stringify(runs);
  if (runs.length > 1 && $('runs').dataset.key !== key && document.activeElement !== $('runs')) {
    $('runs').dataset.key = key;
    $('runs').replaceChildren(...runs.map(({ number, title, outcome }) => Object.assign(document.createElement('option'), {
      value: number, textContent: number ? `${title} ${number}: ${outcome ?? 'runs'}` : title, selected: number === own })));
  }
  if (!run.ended || own) setTimeout(listRuns, 2000);
}

function drawStatus() {
  const { header, ended } = run, states = activeAt(shownTime());
  const leaves = [...states.keys()].filter((state) => state && isLeaf(state, states));
  $('title').textContent = header.title ?? 'Armarium';
  document.title = `${header.title ?? 'Armarium'}${ended ? `: ${ended.outcome}` : ''}`;
  const badge = $('badge');
  badge.textContent = ended ? ended.outcome : run.paused ? 'paused' : run.connected ? 'running' : 'not connected';
  badge.className = `badge ${ended ? (ended.outcome === 'success' ? 'good' : 'bad') : run.connected ? 'runs' : ''}`;
  $('now').textContent = `${shownTime().toFixed(1)} s${isLive() ? '' : ' (looking back)'}`;
  $('where').textContent = leaves.join(' | ') || header.subtitle || '';
  const failed = ended && ended.outcome !== 'success';
  $('problem').hidden = !failed && !run.error;
  $('problem').textContent = run.error ?? (failed ? `${ended.outcome}: ${ended.reason ?? 'no reason was given'}${ended.chain?.length ? ` — through ${ended.chain.join(' < ')}` : ''}` : '');
}

function drawActing() {
  const banner = $('acting');
  banner.hidden = !run.token || Boolean(run.ended);
  if (banner.hidden || banner.dataset.paused === String(run.paused)) return;
  banner.dataset.paused = run.paused;
  banner.replaceChildren('This page can act on the run. ');
  const button = (text, action) => { const made = Object.assign(document.createElement('button'), { type: 'button', textContent: text }); made.onclick = action; banner.append(made, ' '); };
  if (run.paused) { button('go on', () => act({ do: 'go_on' })); button('step', () => act({ do: 'step' })); } else button('pause', () => act({ do: 'pause' }));
  button('stop the robot', () => act({ do: 'stop' }));
  const name = Object.assign(document.createElement('input'), { type: 'text', placeholder: 'event', size: 12 });
  name.setAttribute('aria-label', 'Name of an event');
  banner.append(name, ' ');
  button('give the event', () => name.value && act({ do: 'event', name: name.value }));
}

const words = { transition: (item) => `${item.source || 'the chart'}: ${item.event ?? 'at once'} to ${item.target ?? 'itself'}` };
let lastSaid = 0;
listen((what) => {
  if (what.has('events') && performance.now() - lastSaid > 1000) {
    const event = run.fresh.findLast((each) => each.item.what === 'transition');
    if (event) { lastSaid = performance.now(); $('said').textContent = words.transition(event.item); }
  }
  if (what.has('ended') || what.has('all') && run.ended) $('said').textContent = `The run has ended: ${run.ended.outcome}.`;
  drawPlayer(); drawStatus(); drawActing();
});
show(location.hash.slice(1) in VIEWS ? location.hash.slice(1) : 'overview');
connect();
listRuns();
