// The picture of the chart that is edited: drawn by `armarium graph`, with the state under the cursor and the active states marked.
'use strict';

const { execFile } = require('node:child_process');
const fs = require('node:fs/promises');
const os = require('node:os');
const path = require('node:path');
const vscode = require('vscode');

// After a change it is drawn anew when nothing was typed for so long, ms.
const QUIET = 250;

class Preview {
  // `program()` is the program armarium; `stateAt(document, position)` the path of the state at a place.
  constructor({ program, stateAt }) {
    this.program = program;
    this.stateAt = stateAt;
    this.active = new Map();
    this.subscriptions = [
      vscode.workspace.onDidChangeTextDocument(({ document }) => this.isShown(document) && this.drawSoon()),
      vscode.window.onDidChangeTextEditorSelection((event) => this.followCursor(event.textEditor)),
      vscode.window.onDidChangeActiveTextEditor((editor) => editor && this.follow(editor)),
    ];
  }

  dispose() {
    clearTimeout(this.timer);
    this.subscriptions.forEach((subscription) => subscription.dispose());
    this.panel?.dispose();
  }

  isShown(document) {
    return this.panel && this.document?.uri.toString() === document.uri.toString();
  }

  async show(uri) {
    const chosen = uri ? vscode.Uri.parse(String(uri)) : vscode.window.activeTextEditor?.document.uri;
    if (!chosen) return;
    this.document = await vscode.workspace.openTextDocument(chosen);
    if (!this.panel) {
      const beside = { viewColumn: vscode.ViewColumn.Beside, preserveFocus: true };
      this.panel = vscode.window.createWebviewPanel('armarium.graph', 'Chart', beside, { enableScripts: true, localResourceRoots: [] });
      this.panel.onDidDispose(() => { this.panel = undefined; });
    }
    await this.draw();
  }

  // Another chart that is edited is shown instead.
  async follow(editor) {
    const chart = editor.document.languageId === 'yaml' && /^statechart:/m.test(editor.document.getText());
    if (!this.panel || !chart || this.isShown(editor.document)) return;
    this.document = editor.document;
    await this.draw();
  }

  drawSoon() {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.draw(), QUIET);
  }

  // Draws the text as it is in the editor. A text that cannot be drawn leaves the picture before it.
  async draw() {
    const folder = await fs.mkdtemp(path.join(os.tmpdir(), 'armarium-'));
    try {
      const [chart, picture] = [path.join(folder, 'chart.yaml'), path.join(folder, 'chart.svg')];
      await fs.writeFile(chart, this.document.getText());
      const problem = await new Promise((resolve) => {
        execFile(this.program(), ['graph', chart, '-o', picture, '--depth', '99'], { timeout: 20_000 }, (error, out) => resolve(error && (out || error.message)));
      });
      if (!this.panel) return;
      this.panel.title = path.basename(this.document.uri.fsPath || 'Chart');
      if (problem) {
        await this.panel.webview.postMessage({ problem: 'The picture is that of the last text that could be read.' });
        this.panel.webview.html ||= page('<p>This text cannot be drawn yet.</p>');
        return;
      }
      this.panel.webview.html = page(await fs.readFile(picture, 'utf8'));
      await this.mark();
    } finally {
      await fs.rm(folder, { recursive: true, force: true });
    }
  }

  async followCursor(editor) {
    if (!this.isShown(editor.document)) return;
    const state = await this.stateAt(editor.document, editor.selection.active);
    this.cursor = state || undefined;
    await this.mark();
  }

  // Marks the states, by their paths, that are active in a run of the chart.
  async setActive(uri, states) {
    this.active.set(String(uri), states);
    await this.mark();
  }

  async mark() {
    const active = this.active.get(this.document?.uri.toString()) ?? [];
    await this.panel?.webview.postMessage({ cursor: this.cursor, active });
  }
}

// A page that shows a picture and marks states when it is told to. Nothing is loaded from elsewhere.
function page(picture) {
  const once = Array.from({ length: 24 }, () => Math.floor(Math.random() * 36).toString(36)).join('');
  return `<!DOCTYPE html>
<html><head><meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'unsafe-inline'; script-src 'nonce-${once}'">
<style>
body { padding: 0.5em; } svg { max-width: 100%; height: auto; }
[data-state].cursor { stroke: var(--vscode-focusBorder, #07c) !important; stroke-width: 3 !important; }
[data-state].active { fill: var(--vscode-testing-iconPassed, #7c7) !important; fill-opacity: 0.5; }
#problem { color: var(--vscode-descriptionForeground); }
</style></head><body><div id="problem"></div>${picture}
<script nonce="${once}">
addEventListener('message', ({ data }) => {
  document.getElementById('problem').textContent = data.problem ?? '';
  if (data.problem) return;
  for (const state of document.querySelectorAll('[data-state]')) {
    state.classList.toggle('cursor', state.dataset.state === data.cursor);
    state.classList.toggle('active', (data.active ?? []).includes(state.dataset.state));
  }
  document.querySelector('.cursor')?.scrollIntoView({ block: 'nearest', inline: 'nearest' });
});
</script></body></html>`;
}

module.exports = { Preview, page };
