// Time: which states were active when, events, and any number as a curve below. A click shows that time in all views.

import { run, listen, shownTime, showTime, isLive } from '/run.js';

const [ROW, LEFT, AXIS] = [16, 130, 18];

export function timeView(panel) {
  panel.innerHTML = `<div class="tools"><h2>Time</h2><select aria-label="A number to draw as a curve"><option value="">add a curve …</option></select>
    <span class="curves"></span><button type="button" data-do="all">all</button><button type="button" data-do="out">−</button><button type="button" data-do="in">+</button></div>
    <div class="fill" tabindex="0" role="application" aria-label="States over time; arrow keys move in time"><canvas></canvas></div>`;
  const [select, chosen, fill, canvas] = ['select', '.curves', '.fill', 'canvas'].map((each) => panel.querySelector(each));
  const range = { from: 0, to: null };
  let curves = [], lanes = [], scroll = 0;

  const ends = () => [range.from, range.to ?? Math.max(run.now, 1)];
  function colors() { const style = getComputedStyle(document.documentElement); return (name) => style.getPropertyValue(`--${name}`).trim(); }

  function draw() {
    const { clientWidth: width, clientHeight: height } = fill, ratio = devicePixelRatio || 1;
    if (!width || !height || panel.hidden) return;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) Object.assign(canvas, { width: Math.round(width * ratio), height: Math.round(height * ratio) });
    const pen = canvas.getContext('2d'), color = colors(), [from, to] = ends();
    pen.setTransform(ratio, 0, 0, ratio, 0, 0); pen.clearRect(0, 0, width, height); pen.font = '11px system-ui, sans-serif'; pen.textBaseline = 'middle';
    const left = Math.min(LEFT, width * 0.3), x = (time) => left + (time - from) / (to - from) * (width - left - 4);
    const low = curves.length ? Math.min(height * 0.5, 110 * curves.length) : 0, bottom = height - AXIS - low;
    // States.
    const order = new Map(); for (const { state } of run.spans) if (state && !order.has(state)) order.set(state, order.size);
    lanes = [...order.keys()];
    scroll = Math.max(0, Math.min(scroll, lanes.length * ROW - bottom));
    pen.save(); pen.beginPath(); pen.rect(0, 0, width, bottom); pen.clip();
    for (const [state, at] of order) {
      const y = at * ROW - scroll;
      if (y > bottom || y < -ROW) continue;
      pen.fillStyle = color(at % 2 ? 'back' : 'card'); pen.fillRect(0, y, width, ROW);
      pen.fillStyle = color('dim'); let name = state; while (name.length > 3 && pen.measureText(name).width > left - 8) name = `…${name.slice(name.startsWith('…') ? 2 : 1)}`;
      pen.fillText(name, 3, y + ROW / 2);
    }
    let last = new Map();
    for (const span of run.spans) {
      const y = order.get(span.state) * ROW - scroll, end = span.to ?? run.now;
      if (!span.state || end < from || span.from > to || y > bottom || y < -ROW) continue;
      const [a, b] = [Math.max(left, x(span.from)), x(end)];
      if (last.get(span.state) > Math.max(b, a + 0.7)) continue;
      pen.fillStyle = span.outcome && span.outcome !== 'success' && span.outcome !== 'cancelled' ? color('warn') : span.to === null ? color('on') : color('accent');
      pen.fillRect(a, y + 3, Math.max(1, b - a), ROW - 6); last.set(span.state, Math.max(b, a + 1));
    }
    // Events that came from outside.
    pen.fillStyle = color('bad');
    for (const { time, item } of run.events) if (item.what === 'event' && item.from === null && time >= from && time <= to) pen.fillRect(x(time), bottom - 6, 1, 6);
    pen.restore();
    // Curves.
    curves.forEach((curve, at) => drawCurve(pen, color, curve, { x, left, width, top: bottom + at * low / curves.length, high: low / curves.length }));
    // The axis.
    pen.fillStyle = color('dim'); pen.strokeStyle = color('line');
    const step = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1800, 3600].find((each) => (to - from) / each < (width - left) / 60) ?? 7200;
    for (let time = Math.ceil(from / step) * step; time <= to; time += step) {
      pen.beginPath(); pen.moveTo(x(time), 0); pen.lineTo(x(time), height - AXIS); pen.stroke(); pen.fillText(`${+time.toFixed(1)} s`, x(time) + 2, height - AXIS / 2);
    }
    pen.strokeStyle = color(isLive() ? 'on' : 'bad'); pen.lineWidth = 1.5; pen.beginPath(); pen.moveTo(x(shownTime()), 0); pen.lineTo(x(shownTime()), height); pen.stroke(); pen.lineWidth = 1;
  }
  function drawCurve(pen, color, { topic, name, pieces }, { x, left, width, top, high }) {
    pen.save(); pen.beginPath(); pen.rect(0, top, width, high); pen.clip();
    pen.strokeStyle = color('line'); pen.strokeRect(0, top, width, high);
    const values = pieces.flat().map(([, value]) => value), [least, most] = [Math.min(...values, Infinity), Math.max(...values, -Infinity)];
    const y = (value) => top + high - 8 - (value - least) / (most - least || 1) * (high - 16);
    pen.strokeStyle = color('accent');
    for (const piece of pieces) { pen.beginPath(); piece.forEach(([time, value], at) => (at ? pen.lineTo(x(time), y(value)) : pen.moveTo(x(time), y(value)))); pen.stroke(); }
    pen.fillStyle = color('back'); pen.fillRect(0, top + 1, left - 2, high - 2);
    pen.fillStyle = color('dim');
    const at = run.numbers[topic]?.indexOf(name), now = isLive() ? run.last[topic]?.[at] : pieces.flat().findLast(([time]) => time <= shownTime())?.[1];
    [topic, name, now === undefined || now === null ? '' : `${(+now).toPrecision(4)}`, Number.isFinite(least) ? `${least.toPrecision(3)} to ${most.toPrecision(3)}` : 'no values']
      .forEach((line, row) => pen.fillText(line, 3, top + 10 + row * 14));
    pen.restore();
  }
  let wanted = 0;
  async function refresh(force) {
    if (!curves.length || (!force && performance.now() - wanted < 500)) return;
    wanted = performance.now();
    const [from, to] = ends(), points = Math.max(100, fill.clientWidth);
    await Promise.all(curves.map(async (curve) => {
      const answer = await fetch(`series?${new URLSearchParams({ topic: curve.topic, name: curve.name, from, to, points })}`);
      if (answer.ok) curve.pieces = await answer.json();
    }));
    later();
  }
  function offer() {
    const known = new Set([...select.options].map((each) => each.value));
    for (const [topic, names] of Object.entries(run.numbers)) for (const name of names) {
      const key = JSON.stringify([topic, name]);
      if (!known.has(key)) select.append(Object.assign(document.createElement('option'), { value: key, textContent: `${topic} ${name}` }));
    }
  }
  select.onchange = () => {
    if (!select.value) return;
    const [topic, name] = JSON.parse(select.value); select.value = '';
    const curve = { topic, name, pieces: [] };
    curves.push(curve);
    const button = Object.assign(document.createElement('button'), { type: 'button', textContent: `${name} ✕`, title: `Remove ${topic} ${name}` });
    button.onclick = () => { curves = curves.filter((each) => each !== curve); button.remove(); later(); };
    chosen.append(button); refresh(true);
  };
  const zoom = (factor, around = shownTime()) => {
    const [from, to] = ends();
    range.from = Math.max(0, around - (around - from) * factor); range.to = around + (to - around) * factor;
    if (range.from === 0 && range.to >= run.now) range.to = null;
    refresh(true); later();
  };
  panel.querySelector('.tools').onclick = ({ target }) => ({ all: () => { Object.assign(range, { from: 0, to: null }); refresh(true); later(); }, in: () => zoom(0.5), out: () => zoom(2) })[target.dataset.do]?.();
  const timeAt = (event) => { const [from, to] = ends(), box = fill.getBoundingClientRect(), left = Math.min(LEFT, box.width * 0.3); return from + (event.clientX - box.x - left) / (box.width - left - 4) * (to - from); };
  let drags = false;
  fill.onpointerdown = (event) => { drags = true; fill.setPointerCapture(event.pointerId); showTime(timeAt(event)); };
  fill.onpointermove = (event) => { if (drags) showTime(timeAt(event)); };
  fill.onpointerup = () => { drags = false; };
  fill.addEventListener('wheel', (event) => { event.preventDefault(); if (event.ctrlKey || event.shiftKey) zoom(Math.exp(event.deltaY * 0.002), timeAt(event)); else { scroll += event.deltaY; later(); } }, { passive: false });
  fill.onkeydown = ({ key }) => { const step = { ArrowLeft: -1, ArrowRight: 1 }[key]; if (step) { const [from, to] = ends(); showTime(shownTime() + step * (to - from) / 100); } };
  let due = false;
  const later = () => { if (!due) { due = true; requestAnimationFrame(() => { due = false; draw(); }); } };
  new ResizeObserver(later).observe(fill);
  listen((what) => { if (what.has('all')) offer(); if (isLive() && range.to === null) refresh(false); later(); });
}
