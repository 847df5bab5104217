// Two runs beside each other: they show the same time; their figures, and where their courses differ first.

const $ = (id) => document.getElementById(id);
const frames = [...document.querySelectorAll('iframe')];
window.addEventListener('message', ({ origin, source, data }) => {
  if (origin !== location.origin) return;
  for (const { contentWindow } of frames) if (contentWindow !== source) contentWindow.postMessage(data, origin);
});

const get = async (path) => { const answer = await fetch(path); if (!answer.ok) throw new Error(await answer.text()); return answer.json(); };
const cell = (row, text) => { row.insertCell().textContent = text; };
const number = (value) => (typeof value === 'number' ? String(+value.toPrecision(4)) : value ?? '');

async function compare() {
  const runs = await Promise.all(['/runs/0/run', '/runs/1/run'].map(get)), figures = await Promise.all(['/runs/0/figures', '/runs/1/figures'].map(get));
  const course = ({ events }) => events.map(([stamp, { item }]) => ({ time: stamp * 1e-9, ...item })).filter(({ what }) => what === 'transition');
  const words = (step) => (step ? `${step.source || 'the chart'} to ${step.target ?? 'itself'} (${step.event ?? 'at once'}) at ${step.time.toFixed(2)} s` : 'its end');
  const [a, b] = runs.map(course), same = (x, y) => x && y && ['source', 'target', 'event'].every((key) => x[key] === y[key]);
  let at = 0; while (at < Math.max(a.length, b.length) && same(a[at], b[at])) at += 1;
  const outcomes = runs.map(({ ended }) => ended?.outcome ?? 'not ended').join(' and ');
  $('status').textContent = at === a.length && at === b.length ? `${outcomes}; both took the same ${at} transitions` : `${outcomes}; the same ${at} transitions, then ${words(a[at])} and ${words(b[at])}`;
  const table = document.createElement('table'), head = table.createTHead().insertRow(), body = table.createTBody();
  for (const title of ['figure', 'asked', 'first', 'second', 'difference']) head.append(Object.assign(document.createElement('th'), { textContent: title, scope: 'col' }));
  const name = ({ group, name: title }) => `${group} ${title}`, second = new Map(figures[1].map((figure) => [name(figure), figure]));
  for (const one of figures[0]) {
    const two = second.get(name(one)), row = body.insertRow();
    row.dataset.figure = name(one);
    cell(row, name(one)); cell(row, typeof one.requirement === 'object' ? Object.entries(one.requirement).map(([how, bound]) => `${how.replaceAll('_', ' ')} ${[bound].flat().map(number).join(' and ')}`).join() : '');
    cell(row, `${number(one.value)} ${one.unit ?? ''}`); cell(row, two ? `${number(two.value)} ${two.unit ?? ''}` : '');
    cell(row, two && typeof one.value === 'number' && typeof two.value === 'number' ? number(two.value - one.value) : '');
  }
  $('figures').replaceChildren(figures[0].length ? table : Object.assign(document.createElement('p'), { textContent: 'The first report has no figures.' }));
}
$('differences').onclick = () => { const hidden = $('figures').hidden = !$('figures').hidden; $('differences').setAttribute('aria-expanded', !hidden); };
compare().catch((error) => { $('status').textContent = String(error); });
