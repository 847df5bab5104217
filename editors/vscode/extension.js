// Starts the language server `armarium lsp`, executes the commands of its code lenses, and shows the picture of a chart.
'use strict';

const path = require('node:path');
const vscode = require('vscode');
const { LanguageClient } = require('vscode-languageclient/node');
const { Preview } = require('./preview');
const { RunTerminal } = require('./run');

let client;

function settings() {
  const settings = vscode.workspace.getConfiguration('armarium');
  return { program: settings.get('path', 'armarium'), charts: settings.get('charts', []) };
}

// The file that a command is about: the one that a lens names, otherwise the one that is edited.
function fileOf(uri) {
  const chosen = uri ? vscode.Uri.parse(String(uri)) : vscode.window.activeTextEditor?.document.uri;
  if (!chosen || chosen.scheme !== 'file') {
    vscode.window.showErrorMessage('Armarium: save the chart to a file first.');
    return undefined;
  }
  return chosen.fsPath;
}

// A command runs as a task, so that it can be seen, stopped and repeated, with no shell between.
async function runTask(title, file, execution) {
  await vscode.workspace.saveAll(false);
  const task = new vscode.Task(
    { type: 'armarium', command: title }, vscode.TaskScope.Workspace, `${title} ${path.basename(file)}`, 'armarium', execution,
  );
  return vscode.tasks.executeTask(task);
}

function folders() {
  return settings().charts.flatMap((folder) => ['--charts', folder]);
}

// The run's active states are marked in the preview, if that shows the chart.
async function run(preview, uri) {
  const file = fileOf(uri);
  if (!file) return undefined;
  const chart = vscode.Uri.file(file);
  const terminal = async () => new RunTerminal({
    program: settings().program,
    args: ['run', file, '--json', ...folders()],
    file,
    EventEmitter: vscode.EventEmitter,
    activeChanged: (states) => preview.setActive(chart, states),
  });
  return runTask('run', file, new vscode.CustomExecution(terminal));
}

async function test(uri) {
  const file = fileOf(uri);
  if (!file) return undefined;
  const cases = /\.test\.ya?ml$/.test(file) ? file : file.replace(/\.ya?ml$/, '.test.yaml');
  const process = new vscode.ProcessExecution(settings().program, ['test', cases, ...folders()], { cwd: path.dirname(cases) });
  return runTask('test', cases, process);
}

async function start() {
  const { program, charts } = settings();
  const args = ['lsp', ...charts.flatMap((folder) => ['--charts', folder])];
  client = new LanguageClient(
    'armarium',
    'Armarium',
    { command: program, args },
    {
      documentSelector: [{ language: 'yaml', scheme: 'file' }, { language: 'yaml', scheme: 'untitled' }],
      synchronize: { fileEvents: vscode.workspace.createFileSystemWatcher('**/*.{yaml,yml}') },
    },
  );
  try {
    await client.start();
  } catch (error) {
    const message = `Armarium: \`${program} lsp\` does not start (${error.message}). Is armarium.path right?`;
    const answer = await vscode.window.showErrorMessage(message, 'Open settings');
    if (answer) vscode.commands.executeCommand('workbench.action.openSettings', 'armarium.path');
  }
}

async function restart() {
  await client?.stop();
  await start();
}

async function activate(context) {
  const preview = new Preview({
    program: () => settings().program,
    // The path of the state at a place of a chart.
    stateAt: (document, position) => client.sendRequest('armarium/stateAt', {
      textDocument: { uri: document.uri.toString() },
      position: { line: position.line, character: position.character },
    }),
  });
  const commands = { test, restart, run: (uri) => run(preview, uri), graph: (uri) => preview.show(uri) };
  for (const [name, command] of Object.entries(commands)) {
    context.subscriptions.push(vscode.commands.registerCommand(`armarium.${name}`, command));
  }
  context.subscriptions.push(preview);
  await start();
  // Whoever follows a run elsewhere can mark its active states too: `preview.setActive(uri, ['Wipe.Coaching.Watching'])`.
  return { preview };
}

async function deactivate() {
  await client?.stop();
}

module.exports = { activate, deactivate };
