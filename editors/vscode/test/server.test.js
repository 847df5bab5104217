// The language server, spoken to as VS Code's client library does. ARMARIUM names the program.
'use strict';

const assert = require('node:assert');
const { spawn } = require('node:child_process');
const { test } = require('node:test');
const rpc = require('vscode-languageserver-protocol/node');

const CHART = 'statechart: Demo\ninitial: A\nstates:\n  A: {after: {1s: B}}\n  B: {final: success}\n';

test('the server answers a client', { timeout: 60_000 }, async () => {
  const server = spawn(process.env.ARMARIUM ?? 'armarium', ['lsp'], { stdio: ['pipe', 'pipe', 'inherit'] });
  try {
    await talk(server);
  } finally {
    // A server that is left behind would keep the test from ending.
    server.kill();
  }
});

async function talk(server) {
  const connection = rpc.createProtocolConnection(new rpc.StreamMessageReader(server.stdout), new rpc.StreamMessageWriter(server.stdin));
  const published = [];
  const waiting = [];
  connection.onNotification(rpc.PublishDiagnosticsNotification.type, (params) => {
    published.push(params);
    waiting.splice(0).forEach((wake) => wake());
  });
  const diagnostics = async (version) => {
    for (;;) {
      const found = published.find((params) => params.version === version);
      if (found) return found.diagnostics;
      await new Promise((wake) => { waiting.push(wake); });
    }
  };
  connection.listen();
  const answer = await connection.sendRequest(rpc.InitializeRequest.type, {
    processId: process.pid, rootUri: null, capabilities: { textDocument: { completion: { completionItem: { snippetSupport: true } } } },
  });
  assert.equal(answer.serverInfo.name, 'armarium');
  await connection.sendNotification(rpc.InitializedNotification.type, {});
  const uri = 'file:///nowhere/demo.yaml';
  await connection.sendNotification(rpc.DidOpenTextDocumentNotification.type, {
    textDocument: { uri, languageId: 'yaml', version: 1, text: CHART },
  });
  assert.deepEqual(await diagnostics(1), []);
  const place = { start: { line: 3, character: 18 }, end: { line: 3, character: 19 } };
  await connection.sendNotification(rpc.DidChangeTextDocumentNotification.type, {
    textDocument: { uri, version: 2 }, contentChanges: [{ range: place, text: 'C' }],
  });
  assert.deepEqual((await diagnostics(2)).map(({ code }) => code).slice(0, 1), ['E010']);
  const position = { line: 4, character: 3 };
  const state = await connection.sendRequest('armarium/stateAt', { textDocument: { uri }, position });
  assert.equal(state, 'B');
  const hover = await connection.sendRequest(rpc.HoverRequest.type, { textDocument: { uri }, position });
  assert.match(hover.contents.value, /final: success/);
  await connection.sendRequest(rpc.ShutdownRequest.type);
  await connection.sendNotification(rpc.ExitNotification.type);
  const code = await new Promise((done) => { server.on('exit', done); });
  assert.equal(code, 0);
  connection.dispose();
}
