// Foxglove's own client of its protocol. Arguments: the folder with npm packages, the address, what has to come more than twenty times ("topic
// schema" each). Prints as JSON how many messages of each topic and schema came until then.

import { createRequire } from 'node:module';

const [modules, url, ...wanted] = process.argv.slice(2);
const require = createRequire(`${modules}/`);
const { FoxgloveClient } = require('@foxglove/ws-protocol');
const WebSocket = require('ws');

// The SDK's name of the protocol, which the client does not know by itself yet.
const socket = new WebSocket(url, ['foxglove.sdk.v1']);
socket.binaryType = 'arraybuffer';
const client = new FoxgloveClient({ ws: socket });
const topics = new Map(), came = {};
client.on('error', (error) => { console.error(String(error.message ?? error)); process.exit(1); });
client.on('close', () => { console.error(`the run ended; until then came ${JSON.stringify(came)}`); process.exit(1); });
client.on('advertise', (channels) => {
  for (const { id, topic, schemaName } of channels) { topics.set(client.subscribe(id), `${topic} ${schemaName}`); }
});
client.on('message', ({ subscriptionId, data }) => {
  const topic = topics.get(subscriptionId);
  if (data.byteLength > 0) came[topic] = (came[topic] ?? 0) + 1;
  if (wanted.every((topic) => came[topic] > 20)) { console.log(JSON.stringify(came)); process.exit(0); }
});
