// Values for people, as the command line prints them: numbers with five digits, poses and vectors with their frame.

// A value may come with its kind: `{"float": 15}`.
const KINDS = ['bool', 'int', 'float', 'string', 'duration', 'list', 'map', 'vector', 'pose', 'wrench', 'reference'];
const number = (x) => `${+x.toPrecision(5)}`;
const point = (numbers) => `(${numbers.map(number).join(', ')})`;

export function inWords(value) {
  if (typeof value === 'number') return number(value);
  if (typeof value === 'string') return value;
  if (Array.isArray(value)) return `[${value.map(inWords).join(', ')}]`;
  if (value === null || typeof value !== 'object') return `${value ?? ''}`;
  const fields = Object.entries(value), [[kind, content] = []] = fields;
  if (fields.length === 1 && KINDS.includes(kind)) return kind === 'duration' ? `${inWords(content)} s` : inWords(content);
  if (value.frame && value.components) return `${point(value.components)} in ${value.frame}`;
  if (value.frame && value.orientation) return `${point(value.position)} turned ${point(value.orientation)} in ${value.frame}`;
  if (value.frame && value.torque) return `force ${point(value.force)} torque ${point(value.torque)} in ${value.frame}`;
  if (fields.length === 2 && value.kind && value.id) return value.id;
  return `{${fields.map(([name, part]) => `${name}: ${inWords(part)}`).join(', ')}}`;
}
