// Clicks become labels: first the wrist, then the knuckle of the middle finger, then the tips of stretched fingers.

const by = (id) => document.getElementById(id);
const { images, gestures, token } = await (await fetch('/images')).json();
let at = 0, points = [], gesture = null, empty = false;

function show(number) {
  at = Math.max(0, Math.min(images.length - 1, number));
  const { name, label } = images[at], hand = label?.hand;
  empty = label !== null && hand === null;
  points = hand ? [hand.wrist, hand.knuckle, ...hand.fingertips] : [];
  gesture = hand?.gesture ?? null;
  by('image').src = `/image?${at}`;
  by('name').textContent = name;
  by('problem').textContent = '';
  draw();
}

function draw() {
  const { naturalWidth: width, naturalHeight: height } = by('image'), marks = by('marks');
  marks.setAttribute('viewBox', `0 0 ${width || 1} ${height || 1}`);
  const mark = (name, attributes) => {
    const element = document.createElementNS('http://www.w3.org/2000/svg', name);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    return element;
  };
  const color = (i) => (i < 2 ? '#ffd400' : '#ff28c8');
  const circles = points.map(([cx, cy], i) => mark('circle', { cx, cy, r: width / 100, stroke: color(i) }));
  const [[x1, y1], [x2, y2]] = points.length > 1 ? points : [[0, 0], [0, 0]];
  marks.replaceChildren(mark('line', { x1, y1, x2, y2 }), ...circles);
  const asked = ['Click the middle of the wrist, or choose «no hand».', 'Click the knuckle of the middle finger.', 'Click the tip of each stretched finger; choose the gesture.'];
  by('ask').textContent = empty ? 'There is no hand in this image.' : asked[Math.min(points.length, 2)];
  by('none').setAttribute('aria-pressed', empty);
  for (const button of by('gestures').children) button.setAttribute('aria-pressed', button.value === (gesture ?? ''));
  by('count').textContent = `image ${at + 1} of ${images.length}, ${images.filter(({ label }) => label !== null).length} labelled`;
}

// Keeps the label, as soon as it is one.
async function keep() {
  draw();
  if (!empty && points.length < 2) return;
  const [wrist, knuckle, ...fingertips] = points;
  const number = at, hand = empty ? null : { wrist, knuckle, fingertips, gesture };
  const answer = await fetch('/label', { method: 'POST', headers: { 'x-armarium-token': token }, body: JSON.stringify({ image: number, hand }) });
  if (answer.ok) images[number].label = { hand };
  by('problem').textContent = answer.ok ? '' : await answer.text();
  draw();
}

const choose = (name) => { gesture = name; keep(); };
const undo = () => { empty = false; points.pop(); keep(); };
const none = () => { empty = true; points = []; gesture = null; keep(); };
by('gestures').append(...[['', 'none (0)'], ...gestures.map((name, i) => [name, `${name.replace('_', ' ')} (${i + 1})`])].map(([value, text]) => {
  const button = Object.assign(document.createElement('button'), { value, textContent: text });
  button.onclick = () => choose(value || null);
  return button;
}));
by('figure').onclick = ({ clientX, clientY }) => {
  const image = by('image'), box = image.getBoundingClientRect();
  empty = false;
  points.push([(clientX - box.left) / box.width * image.naturalWidth, (clientY - box.top) / box.height * image.naturalHeight].map((v) => Math.round(v * 10) / 10));
  keep();
};
by('image').onload = draw;
by('before').onclick = () => show(at - 1);
by('next').onclick = () => show(at + 1);
by('none').onclick = none;
by('undo').onclick = undo;
document.onkeydown = ({ key, ctrlKey, metaKey, altKey }) => {
  if (ctrlKey || metaKey || altKey) return;
  const keys = { ArrowLeft: () => show(at - 1), ArrowRight: () => show(at + 1), n: none, u: undo, 0: () => choose(null) };
  gestures.forEach((name, i) => { keys[i + 1] = () => choose(name); });
  keys[key]?.();
};
// The next one without a label.
show(Math.max(0, images.findIndex(({ label }) => label === null)));
