// Memory: the entities by segment, what is known of them, how sure, since when, from whom.

import { run, listen } from '/run.js';

const short = (value) => { const text = typeof value === 'string' ? value : JSON.stringify(value, (_, v) => (typeof v === 'number' ? +v.toPrecision(5) : v)); return text && text.length > 140 ? `${text.slice(0, 140)}…` : text ?? ''; };

export function memoryView(panel) {
  panel.innerHTML = `<div class="tools"><h2>Memory</h2><input type="search" placeholder="find an entity" aria-label="Find an entity"></div><div class="fill" tabindex="0" role="region" aria-label="What memory knows"></div>`;
  const [search, fill] = [panel.querySelector('input'), panel.querySelector('.fill')];
  const open = new Set();
  let due = false;
  function draw() {
    due = false;
    if (panel.hidden) return;
    const sought = search.value.trim().toLowerCase(), segments = new Map();
    for (const [id, known] of run.entities) if (!sought || id.toLowerCase().includes(sought)) { const segment = id.split('/')[0]; segments.set(segment, [...(segments.get(segment) ?? []), [id, known]]); }
    const parts = [];
    for (const [segment, entities] of [...segments].sort()) {
      parts.push(Object.assign(document.createElement('h3'), { textContent: `${segment} (${entities.length})` }));
      const table = document.createElement('table');
      for (const [id, known] of entities.sort()) {
        const row = table.insertRow(), age = run.now - known.referenced_ns * 1e-9;
        row.dataset.entity = id; row.tabIndex = 0; row.setAttribute('role', 'button'); row.setAttribute('aria-expanded', open.has(id));
        const turn = () => { if (open.has(id)) open.delete(id); else open.add(id); draw(); };
        row.onclick = turn; row.onkeydown = ({ key }) => { if (key === 'Enter') turn(); };
        row.insertCell().textContent = id.split('/').slice(1).join('/');
        row.insertCell().textContent = known.confidence === undefined ? '' : `${Math.round(known.confidence * 100)} %`;
        row.insertCell().textContent = Number.isFinite(age) ? age < 0.05 ? 'now' : `${age.toFixed(1)} s ago` : '';
        row.insertCell().append(Object.assign(document.createElement('code'), { textContent: open.has(id) ? JSON.stringify(known, null, 1) : short(known.attributes) }));
      }
      parts.push(table);
    }
    if (!parts.length) parts.push(Object.assign(document.createElement('p'), { className: 'dim', textContent: run.entities.size ? 'Nothing of this name.' : 'Memory knows nothing yet, or this recording has no memory.' }));
    const { scrollTop } = fill; fill.replaceChildren(...parts); fill.scrollTop = scrollTop;
  }
  let last = 0;
  const later = () => { if (!due) { due = true; setTimeout(() => { last = performance.now(); draw(); }, Math.max(0, 300 - (performance.now() - last))); } };
  search.oninput = draw;
  window.addEventListener('resize', later);
  listen((what) => { if (what.has('memory') || what.has('all')) later(); });
}
