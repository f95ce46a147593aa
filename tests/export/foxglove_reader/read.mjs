// Reads an MCAP file as Foxglove and Lichtblick do, from the schemas in the file alone, and prints JSON:
// per topic its schema and its decoded messages, and what the schemas lack of the official definitions.
import { readFile } from "node:fs/promises";
import { McapIndexedReader, McapStreamReader } from "@mcap/core";
import { loadDecompressHandlers } from "@mcap/support";
import * as official from "@foxglove/schemas/jsonschema.js";
import protobuf from "protobufjs";
import "protobufjs/ext/descriptor/index.js";

const data = await readFile(process.argv[2]);
const decompressHandlers = await loadDecompressHandlers();
const readable = {
  size: async () => BigInt(data.length),
  read: async (offset, length) => new Uint8Array(data.buffer, data.byteOffset + Number(offset), Number(length)),
};
const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });

const types = new Map();
const missing = [];
for (const schema of reader.schemasById.values()) {
  const root = protobuf.Root.fromDescriptor(schema.data);
  root.resolveAll();
  types.set(schema.id, root.lookupType(schema.name));
  if (schema.name.startsWith("foxglove.")) {
    compare(root, schema.name);
  }
}

// Every field of the official definition has to be in the file's own.
function compare(root, name) {
  const definition = official[name.split(".").at(-1)];
  const fields = root.lookupType(name).fields;
  for (const key of Object.keys(definition?.properties ?? { [`${name} itself`]: 0 })) {
    if (!(key in fields)) {
      missing.push(`${name}.${key}`);
    }
  }
}

const topics = {};
for await (const message of reader.readMessages({ validateCrcs: true })) {
  const channel = reader.channelsById.get(message.channelId);
  const type = types.get(channel.schemaId);
  const decoded = type.toObject(type.decode(message.data), { longs: Number, enums: Number, defaults: true });
  const topic = (topics[channel.topic] ??= { schema: type.fullName.slice(1), messages: [] });
  topic.messages.push([String(message.logTime), decoded]);
}

// The other reader of the library, front to back, has to find as much.
const stream = new McapStreamReader({ decompressHandlers, validateCrcs: true });
stream.append(data);
let streamed = 0;
for (let record; (record = stream.nextRecord()); ) {
  streamed += record.type === "Message" ? 1 : 0;
}
console.log(JSON.stringify({ topics, missing, streamed, done: stream.done() }));
