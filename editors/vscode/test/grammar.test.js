// Expressions inside of YAML get the scopes of expressions, and nothing else does.
'use strict';

const assert = require('node:assert');
const fs = require('node:fs');
const path = require('node:path');
const { test } = require('node:test');
const { loadWASM, OnigScanner, OnigString } = require('vscode-oniguruma');
const { INITIAL, Registry, parseRawGrammar } = require('vscode-textmate');

// Enough of YAML for the injection: VS Code brings the whole one.
const YAML = {
  scopeName: 'source.yaml',
  patterns: [
    { match: '#.*$', name: 'comment.line.number-sign.yaml' },
    { begin: '"', end: '"', name: 'string.quoted.double.yaml', patterns: [] },
    { match: '[A-Za-z_]+(?=:)', name: 'entity.name.tag.yaml' },
  ],
};

async function grammar() {
  const wasm = fs.readFileSync(require.resolve('vscode-oniguruma/release/onig.wasm'));
  await loadWASM(wasm.buffer.slice(wasm.byteOffset, wasm.byteOffset + wasm.byteLength));
  const file = path.join(__dirname, '..', 'syntaxes', 'expressions.json');
  const registry = new Registry({
    onigLib: Promise.resolve({
      createOnigScanner: (patterns) => new OnigScanner(patterns),
      createOnigString: (text) => new OnigString(text),
    }),
    loadGrammar: async (scope) => (scope === 'source.yaml' ? YAML : parseRawGrammar(fs.readFileSync(file, 'utf8'), file)),
    getInjections: (scope) => (scope === 'source.yaml' ? ['armarium.expressions'] : undefined),
  });
  return registry.loadGrammar('source.yaml');
}

test('expressions are told from text', async () => {
  const yaml = await grammar();
  const scopes = (line, text) => {
    const { tokens } = yaml.tokenizeLine(line, INITIAL);
    const at = line.indexOf(text);
    return tokens.find((token) => token.startIndex <= at && at < token.endIndex).scopes.join(' ');
  };
  const line = 'with: {force: "${norm(channels.wrist) + 2.5}", name: "plain $${text}"}';
  assert.match(scopes(line, 'norm'), /support\.function\.armarium/);
  assert.match(scopes(line, 'channels'), /variable\.language\.armarium/);
  assert.match(scopes(line, 'wrist'), /variable\.other\.armarium/);
  assert.match(scopes(line, '2.5'), /constant\.numeric\.armarium/);
  assert.match(scopes(line, '$${'), /constant\.character\.escape/);
  assert.doesNotMatch(scopes(line, 'text'), /expression/);
  assert.doesNotMatch(scopes(line, 'name'), /expression/);
  const condition = '  pushed: {if: "norm(channels.wrist.push) > 6.0", for: 100ms}';
  assert.match(scopes(condition, 'norm'), /support\.function\.armarium/);
  assert.match(scopes(condition, '6.0'), /constant\.numeric\.armarium/);
  assert.doesNotMatch(scopes(condition, 'for'), /expression/);
  assert.match(scopes('# ${inputs.a}', 'inputs'), /comment/);
});
