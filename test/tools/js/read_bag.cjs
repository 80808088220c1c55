// Reads MCAP files as Foxglove does, indexed, and prints each message as a line of JSON:
// {topic, type, log, publish, sequence, message}; what JSON has no number for is a string.
"use strict";
const { open } = require("node:fs/promises");
const { McapIndexedReader } = require("@mcap/core");
const { FileHandleReadable } = require("@mcap/nodejs");
const { loadDecompressHandlers } = require("@mcap/support");
const { parse } = require("@foxglove/rosmsg");
const { MessageReader } = require("@foxglove/rosmsg2-serialization");

function plain(key, value) {
  if (typeof value === "bigint") return value.toString();
  if (typeof value === "number" && (!Number.isFinite(value) || Object.is(value, -0))) {
    return Object.is(value, -0) ? "-0" : String(value);
  }
  if (ArrayBuffer.isView(value)) return Array.from(value);
  return value;
}

async function read(path, decompressHandlers) {
  const handle = await open(path, "r");
  const reader = await McapIndexedReader.Initialize({ readable: new FileHandleReadable(handle), decompressHandlers });
  const decoders = new Map();
  for await (const record of reader.readMessages()) {
    const channel = reader.channelsById.get(record.channelId);
    const schema = reader.schemasById.get(channel.schemaId);
    if (schema.encoding !== "ros2msg" || channel.messageEncoding !== "cdr") throw new Error(`encoding of ${channel.topic}`);
    if (!decoders.has(record.channelId)) {
      const definition = parse(new TextDecoder().decode(schema.data), { ros2: true });
      decoders.set(record.channelId, new MessageReader(definition));
    }
    const message = decoders.get(record.channelId).readMessage(record.data);
    const { sequence, logTime: log, publishTime: publish } = record;
    const line = { topic: channel.topic, type: schema.name, log, publish, sequence, message };
    process.stdout.write(`${JSON.stringify(line, plain)}\n`);
  }
  await handle.close();
}

(async () => {
  const handlers = await loadDecompressHandlers();
  for (const path of process.argv.slice(2)) await read(path, handlers);
})().catch((error) => {
  process.stderr.write(`${error.stack}\n`);
  process.exit(1);
});
