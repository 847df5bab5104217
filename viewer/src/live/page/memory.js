// Memory: the entities by segment, what is known of them, how sure, since when, from whom.

import { run, listen, isLive, shownTime, showTime } from '/run.js';
import { inWords } from '/words.js';

const short = (value) => { const text = inWords(value); return text.length > 140 ? `${text.slice(0, 140)}…` : text; };

export function memoryView(panel) {
  panel.innerHTML = `<div class="tools"><h2>Memory</h2><input type="search" placeholder="find an entity" aria-label="Find an entity"></div><div class="fill known" tabindex="0" role="region" aria-label="What memory knows"></div>`;
  const [search, fill] = [panel.querySelector('input'), panel.querySelector('.fill')];
  const open = new Set();
  let due = false;
  const histories = new Map();
  let then = null, asking = false;
  // What memory knew at the time that is shown.
  async function look() {
    if (isLive() || panel.hidden || asking) { if (isLive()) then = null; return later(); }
    asking = true;
    const time = shownTime();
    try { then = new Map(Object.entries(await (await fetch(`memory?t=${time}`)).json())); } catch { /* The program has ended. */ }
    asking = false; later();
    if (time !== shownTime()) look();
  }
  async function recall(id) {
    try { histories.set(id, await (await fetch(`history?${new URLSearchParams({ entity: id })}`)).json()); } catch { return; }
    later();
  }
  function attributes(known) {
    const list = document.createElement('dl');
    for (const [name, value] of Object.entries(known.attributes ?? {})) list.append(Object.assign(document.createElement('dt'), { textContent: name }), Object.assign(document.createElement('dd'), { textContent: short(value) }));
    return list;
  }
  function history(id) {
    const table = document.createElement('table');
    for (const [time, known] of (histories.get(id) ?? []).slice(-30).reverse()) {
      const row = table.insertRow();
      row.insertCell().append(Object.assign(document.createElement('button'), { type: 'button', textContent: `${time.toFixed(2)} s`, onclick: (event) => { event.stopPropagation(); showTime(time); } }));
      row.insertCell().append(Object.assign(document.createElement('code'), { textContent: known ? short(known.attributes) : 'removed' }));
    }
    return table;
  }
  function draw() {
    due = false;
    if (panel.hidden) return;
    const sought = search.value.trim().toLowerCase(), segments = new Map(), now = shownTime();
    for (const [id, known] of then ?? run.entities) if (known && (!sought || id.toLowerCase().includes(sought))) { const segment = id.split('/')[0]; segments.set(segment, [...(segments.get(segment) ?? []), [id, known]]); }
    const parts = [];
    for (const [segment, entities] of [...segments].sort()) {
      parts.push(Object.assign(document.createElement('h3'), { textContent: `${segment} (${entities.length})` }));
      const table = document.createElement('table');
      for (const [id, known] of entities.sort()) {
        const row = table.insertRow(), age = now - known.referenced_ns * 1e-9;
        row.dataset.entity = id; row.tabIndex = 0; row.setAttribute('role', 'button'); row.setAttribute('aria-expanded', open.has(id));
        const turn = () => { if (open.has(id)) open.delete(id); else { open.add(id); recall(id); } draw(); };
        row.onclick = turn; row.onkeydown = ({ key, target }) => { if (key === 'Enter' && target === row) turn(); };
        const [provider, ...name] = id.split('/').slice(1);
        const where = row.insertCell(); where.className = 'id';
        where.append(Object.assign(document.createElement('b'), { textContent: name.join('/') }), Object.assign(document.createElement('span'), { className: 'dim', textContent: ` by ${provider}` }));
        Object.assign(row.insertCell(), { className: 'few', textContent: known.confidence === undefined || known.confidence === null ? '' : `${Math.round(known.confidence * 100)} %` });
        Object.assign(row.insertCell(), { className: 'few', textContent: !Number.isFinite(age) ? '' : age < 0.05 ? 'now' : age < 120 ? `${age.toFixed(1)} s ago` : `${Math.round(age / 60)} min ago` });
        const what = row.insertCell();
        what.append(attributes(known));
        if (open.has(id)) what.append(Object.assign(document.createElement('p'), { className: 'dim', textContent: `version ${known.version}; before:` }), history(id));
      }
      parts.push(table);
    }
    if (!parts.length) parts.push(Object.assign(document.createElement('p'), { className: 'dim', textContent: sought ? 'Nothing of this name.' : 'Memory knows nothing yet.' }));
    const { scrollTop } = fill; fill.replaceChildren(...parts); fill.scrollTop = scrollTop;
  }
  let last = 0;
  const later = () => { if (!due) { due = true; setTimeout(() => { last = performance.now(); draw(); }, Math.max(0, 300 - (performance.now() - last))); } };
  search.oninput = draw;
  window.addEventListener('resize', look);
  listen((what) => { if (what.has('cursor')) look(); else if (what.has('memory') || what.has('all')) later(); });
}
