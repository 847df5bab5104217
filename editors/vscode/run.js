// A run of a chart in a terminal of the editor: what happens as lines of text, and which states are active for the preview.
'use strict';

const { spawn } = require('node:child_process');
const path = require('node:path');
const readline = require('node:readline');

// VS Code's interface of a terminal (Pseudoterminal) around `armarium run FILE --json`.
class RunTerminal {
  // `activeChanged(states)` is told the paths of the active states after each change.
  constructor({ program, args, file, EventEmitter, activeChanged }) {
    Object.assign(this, { program, args, file, activeChanged });
    this.written = new EventEmitter();
    this.closed = new EventEmitter();
    this.onDidWrite = this.written.event;
    this.onDidClose = this.closed.event;
    this.active = new Set();
  }

  open() {
    this.process = spawn(this.program, this.args, { cwd: path.dirname(this.file), stdio: ['ignore', 'pipe', 'pipe'] });
    readline.createInterface({ input: this.process.stdout }).on('line', (line) => this.line(line));
    readline.createInterface({ input: this.process.stderr }).on('line', (line) => this.write(line));
    this.process.on('error', (error) => this.write(`${this.program} does not start: ${error.message}`));
    this.process.on('close', (code) => {
      this.activeChanged([]);
      this.closed.fire(code ?? 1);
    });
  }

  // The run ends as with Ctrl-C: the robot stands, and the report is written.
  close() {
    this.process?.kill('SIGINT');
  }

  write(text) {
    this.written.fire(`${text}\r\n`);
  }

  line(text) {
    let event;
    try {
      event = JSON.parse(text);
    } catch {
      this.write(text);
      return;
    }
    if (event.outcome) this.write(`${event.outcome}${event.reason ? `: ${event.reason}` : ''}; the report is in ${event.report}`);
    const { item } = event;
    if (item?.what === 'entered') this.active.add(item.state);
    if (item?.what === 'exited') this.active.delete(item.state);
    if (item?.what === 'entered' || item?.what === 'exited') this.activeChanged([...this.active]);
    const shown = shownAs(item);
    if (shown) this.write(`${(event.at_ns / 1e9).toFixed(2).padStart(8)} s  ${shown}`);
  }
}

// An item of the trace as a line of text; nothing for those that say little to people.
function shownAs(item) {
  switch (item?.what) {
    case 'transition': return `${item.source}: ${item.event ?? 'no event'} -> ${item.target ?? 'stays'}`;
    case 'skill_started': return `${item.state}: ${item.skill} begins`;
    case 'skill_ended': return `${item.state}: ends with ${item.outcome}${item.outcome === 'failure' && item.reason ? `: ${item.reason}` : ''}`;
    case 'log': return `${item.state}: ${item.text}`;
    case 'error': return `${item.place}: ${item.message}`;
    case 'dropped': return `${item.name}: this event is dropped: ${item.reason}`;
    default: return undefined;
  }
}

module.exports = { RunTerminal };
