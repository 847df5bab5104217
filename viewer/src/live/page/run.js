// The run as the page knows it: what it was told, and what was the case at a time. It draws nothing.

const MOST_EVENTS = 20000;
const MOST_LATER = 1000;
const listeners = new Set();
export const run = {
  header: {}, events: [], from: 0, spans: [], now: 0, cursor: null, active: new Map(), poses: {}, shown: {}, last: {}, numbers: {},
  images: [], entities: new Map(), ended: null, token: null, paused: false, connected: false, open: new Map(), error: null,
};
export const listen = (call) => { listeners.add(call); call(new Set(['all'])); };
const tell = (what) => listeners.forEach((call) => call(what));

// The time that all views show, s.
export const shownTime = () => run.cursor ?? run.now;
export const isLive = () => run.cursor === null;

export function showTime(time, told = false) {
  run.cursor = time === null || time >= run.now && run.ended === null ? null : Math.max(0, Math.min(time, run.now));
  if (run.cursor !== null) askPoses(run.cursor); else run.shown = run.poses;
  tell(new Set(['cursor']));
  // Two runs beside each other show the same time.
  if (!told && window.parent !== window) window.parent.postMessage({ time: run.cursor }, location.origin);
}
window.addEventListener('message', ({ origin, source, data }) => {
  if (origin === location.origin && source === window.parent && source !== window && 'time' in data) showTime(data.time ?? run.now, true);
});

let asked = null, asking = false;
async function askPoses(time) {
  asked = time;
  if (asking) return;
  asking = true;
  while (asked !== null) {
    const at = asked; asked = null;
    try { run.shown = await (await fetch(`poses?t=${at}`)).json(); tell(new Set(['poses'])); } catch { /* The program has ended. */ }
  }
  asking = false;
}

// The states that are active at a time, with since when.
export function activeAt(time) {
  if (isLive()) return run.active;
  const found = new Map();
  for (const span of run.spans) if (span.from <= time && (span.to === null || span.to > time)) found.set(span.state, span.from);
  return found;
}
export const isLeaf = (state, states) => ![...states.keys()].some((other) => other !== state && (state === '' || other.startsWith(`${state}.`)));

function take(event) {
  const [stamp, { item }] = event, time = stamp * 1e-9;
  if (item.what === 'entered') {
    run.active.set(item.state, time);
    const span = { state: item.state, from: time, to: null, outcome: null };
    run.open.set(item.state, span); run.spans.push(span);
  } else if (item.what === 'exited') {
    run.active.delete(item.state);
    const span = run.open.get(item.state);
    if (span) { span.to = time; run.open.delete(item.state); }
  } else if (item.what === 'skill_ended') {
    const span = run.open.get(item.state);
    if (span) span.outcome = item.outcome;
  }
  event.time = time; event.item = item;
  run.events.push(event);
}

function bound() {
  if (run.events.length > MOST_EVENTS * 1.2) { const gone = run.events.length - MOST_EVENTS; run.events.splice(0, gone); run.from += gone; }
  if (run.spans.length > MOST_EVENTS * 1.2) run.spans.splice(0, run.spans.length - MOST_EVENTS);
}

// News that come while all is asked for are taken after it: the last of them is the newest.
let loads = 0;
const later = [];

function takeNews(news) {
  if (loads) { later.push(news); if (later.length > MOST_LATER) later.shift(); return; }
  const what = new Set(['time']);
  const next = run.from + run.events.length;
  if (news.from > next) return load();
  const fresh = news.events.slice(Math.max(0, next - news.from));
  if (fresh.length) { fresh.forEach(take); bound(); what.add('events'); run.fresh = fresh; }
  run.now = news.now_ns * 1e-9;
  Object.assign(run.poses, news.poses); if (isLive()) run.shown = run.poses;
  run.last = news.last;
  if (run.paused !== news.told.paused) { run.paused = news.told.paused; what.add('paused'); }
  for (const [id, known] of Object.entries(news.entities)) { if (known) run.entities.set(id, known); else run.entities.delete(id); what.add('memory'); }
  if (news.ended && !run.ended) { run.ended = news.ended; what.add('ended'); load(); }
  tell(what);
}

export async function load() {
  loads += 1;
  let all;
  try { all = await (await fetch('run')).json(); } finally { loads -= 1; }
  const { header, active, numbers, images, entities, ended, token, told: { paused } } = all;
  Object.assign(run, { header, numbers, images, ended, token, paused, events: [], from: all.from, spans: [], active: new Map(), open: new Map(),
    now: all.now_ns * 1e-9, poses: all.poses, last: all.last, entities: new Map(Object.entries(entities).filter(([, known]) => known)) });
  // What was entered before the first event that is kept.
  const began = Object.entries(active).map(([state, stamp]) => ({ state, from: stamp * 1e-9, to: null, outcome: null }));
  all.events.forEach(take);
  for (const span of began) if (!run.open.has(span.state)) { run.open.set(span.state, span); run.spans.unshift(span); run.active.set(span.state, span.from); }
  if (isLive()) run.shown = run.poses; else askPoses(run.cursor);
  tell(new Set(['all']));
  if (!loads) later.splice(0).forEach(takeNews);
}

// Browsers keep few connections to one place: of all tabs of a run one is told the news, and tells the others.
export async function connect() {
  await load();
  if (run.ended) return;
  const channel = 'BroadcastChannel' in window ? new BroadcastChannel(`armarium ${location.host}${location.pathname}`) : null;
  if (channel) channel.onmessage = ({ data }) => (data === 'missed' ? load() : takeNews(JSON.parse(data)));
  const lead = () => new Promise((done) => {
    const source = new EventSource('news');
    source.onopen = () => { run.connected = true; tell(new Set(['connection'])); load(); };
    source.onmessage = ({ data }) => { channel?.postMessage(data); takeNews(JSON.parse(data)); };
    listen(() => { if (run.ended) { source.close(); done(); } });
    source.addEventListener('missed', () => { channel?.postMessage('missed'); load(); });
    source.onerror = () => { run.connected = false; tell(new Set(['connection'])); };
  });
  run.connected = true;
  if (navigator.locks) navigator.locks.request(`armarium ${location.host}${location.pathname}`, lead); else lead();
}

export async function act(action) {
  const answer = await fetch('act', { method: 'POST', headers: { 'x-armarium-token': run.token ?? '' }, body: JSON.stringify(action) });
  run.error = answer.ok ? null : await answer.text();
  tell(new Set(['acted']));
}
