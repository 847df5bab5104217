// The extension as VS Code loads it: with VS Code's interface replaced by one that notes what it is asked.
'use strict';

const assert = require('node:assert');
const fs = require('node:fs');
const os = require('node:os');
const path = require('node:path');
const Module = require('node:module');
const { test } = require('node:test');

const manifest = require('../package.json');

const noted = { commands: new Map(), tasks: [], messages: [], requests: [] };
const nothing = () => ({ dispose() {} });
const text = 'statechart: Demo\ninitial: A\nstates:\n  A: {after: {1s: B}}\n  B: {final: success}\n';
const folder = fs.mkdtempSync(path.join(os.tmpdir(), 'armarium-test-'));
const chart = path.join(folder, 'demo.yaml');
const document = { uri: { scheme: 'file', fsPath: chart, toString: () => `file://${chart}` }, languageId: 'yaml', getText: () => text };

// Stands for the program: it draws one state, and its run is in one state for a while.
const program = path.join(folder, 'armarium');
fs.writeFileSync(program, `#!/bin/sh
if [ "$1" = graph ]; then echo '<svg><rect data-state="A"/></svg>' > "$4"; exit; fi
echo '{"at_ns":0,"item":{"what":"entered","state":"A"}}'
echo '{"at_ns":1500000000,"item":{"what":"transition","source":"A","event":"go","target":"B"}}'
echo '{"at_ns":1500000000,"item":{"what":"exited","state":"A"}}'
echo '{"outcome":"success","reason":null,"report":"report"}'
`, { mode: 0o755 });

const vscode = {
  ViewColumn: { Beside: -2 },
  TaskScope: { Workspace: 2 },
  Uri: { parse: () => document.uri, file: () => document.uri },
  EventEmitter: class {
    constructor() { this.event = (listener) => { this.listener = listener; return nothing(); }; }
    fire(value) { this.listener?.(value); }
  },
  ProcessExecution: class { constructor(process, args) { Object.assign(this, { process, args }); } },
  CustomExecution: class { constructor(terminal) { this.terminal = terminal; } },
  Task: class { constructor(...parts) { this.execution = parts[4]; } },
  commands: { registerCommand: (name, command) => { noted.commands.set(name, command); return nothing(); } },
  tasks: { executeTask: (task) => { noted.tasks.push(task.execution); } },
  window: {
    showErrorMessage: (message) => { noted.messages.push(message); },
    onDidChangeTextEditorSelection: (listener) => { noted.select = listener; return nothing(); },
    onDidChangeActiveTextEditor: nothing,
    createWebviewPanel: () => {
      noted.panel = { webview: { html: '', postMessage: async (message) => { noted.posted = message; } }, onDidDispose: nothing, dispose() {} };
      return noted.panel;
    },
  },
  workspace: {
    getConfiguration: () => ({ get: (key, other) => ({ path: program, charts: ['shared'] })[key] ?? other }),
    createFileSystemWatcher: nothing,
    onDidChangeTextDocument: nothing,
    openTextDocument: async () => document,
    saveAll: async () => true,
  },
};

class LanguageClient {
  constructor(id, name, server) { noted.server = [server.command, ...server.args]; }
  async start() {}
  async stop() {}
  async sendRequest(method) { noted.requests.push(method); return 'A'; }
}

const load = Module._load;
Module._load = (name, ...more) => {
  if (name === 'vscode') return vscode;
  if (name === 'vscode-languageclient/node') return { LanguageClient };
  return load(name, ...more);
};

test('the extension does what its manifest says', async () => {
  const extension = require('../extension');
  const { preview } = await extension.activate({ subscriptions: [] });
  assert.deepEqual(noted.server, [program, 'lsp', '--charts', 'shared']);
  const declared = manifest.contributes.commands.map(({ command }) => command).sort();
  assert.deepEqual([...noted.commands.keys()].sort(), declared);
  await noted.commands.get('armarium.test')(`file://${chart}`);
  const [played] = noted.tasks;
  assert.deepEqual([played.process, ...played.args], [program, 'test', chart.replace('.yaml', '.test.yaml'), '--charts', 'shared']);
  await noted.commands.get('armarium.graph')('file:///charts/demo.yaml');
  assert.match(noted.panel.webview.html, /data-state="A"/);
  await noted.select({ textEditor: { document, selection: { active: { line: 3, character: 2 } } } });
  assert.deepEqual([noted.requests, noted.posted], [['armarium/stateAt'], { cursor: 'A', active: [] }]);
  await preview.setActive(document.uri, ['A']);
  assert.deepEqual(noted.posted, { cursor: 'A', active: ['A'] });
  await noted.commands.get('armarium.run')(`file://${chart}`);
  const [lines, active] = await followed(await noted.tasks[1].terminal(), preview);
  assert.deepEqual(active, [['A'], [], []]);
  assert.deepEqual(lines, ['    1.50 s  A: go -> B', 'success; the report is in report']);
  preview.dispose();
  await extension.deactivate();
  assert.deepEqual(noted.messages, []);
});

// What a run's terminal shows, and the states that the preview marks, until it ends.
async function followed(terminal, preview) {
  const [lines, active] = [[], []];
  preview.setActive = async (_, states) => { active.push(states); };
  terminal.onDidWrite((text) => lines.push(text.trimEnd()));
  const ended = new Promise((resolve) => terminal.onDidClose(resolve));
  terminal.open();
  assert.equal(await ended, 0);
  return [lines, active];
}

test('everything that the manifest names is there', () => {
  const root = path.join(__dirname, '..');
  for (const file of [manifest.main, manifest.icon, ...manifest.contributes.grammars.map((grammar) => grammar.path)]) {
    assert.ok(fs.existsSync(path.join(root, file)), file);
  }
});
