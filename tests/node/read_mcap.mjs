// node read_mcap.mjs FILE...: what @mcap/core reads in each file, as JSON.
//
// Once by its index and once from front to back, all checksums checked, and each message decoded by
// the schema in the file: nothing here knows armrig.

import { open, readFile } from "node:fs/promises";
import { McapIndexedReader, McapStreamReader } from "@mcap/core";
import { loadDecompressHandlers, protobufFromBinaryDescriptor } from "@mcap/support";

const decompressHandlers = await loadDecompressHandlers();

/** A file as @mcap/core wants to read it. */
async function readable(path) {
  const file = await open(path);
  return {
    size: async () => BigInt((await file.stat()).size),
    read: async (offset, length) => {
      const buffer = new Uint8Array(Number(length));
      await file.read(buffer, 0, buffer.length, Number(offset));
      return buffer;
    },
    close: () => file.close(),
  };
}

/** Decodes the messages of a channel. */
function decoder(schema) {
  const type = protobufFromBinaryDescriptor(schema.data).lookupType(schema.name);
  return (data) => type.toObject(type.decode(data), { longs: Number, defaults: true });
}

/** Counts messages, and adds up what they say. */
class Tally {
  constructor() {
    this.topics = {};
    this.samples = { k: [], counts: 0, u: 0 };
  }

  add(topic, decode, message) {
    const fields = decode(message.data);
    this.topics[topic] = (this.topics[topic] ?? 0) + 1;
    if (topic.endsWith("/sample")) {
      this.samples.k.push(fields.k);
      this.samples.counts += fields.theta_1_counts;
      this.samples.u += fields.u_applied_v;
    }
  }
}

async function byIndex(path) {
  const source = await readable(path);
  const reader = await McapIndexedReader.Initialize({ readable: source, decompressHandlers });
  const decoders = new Map();
  for (const [id, channel] of reader.channelsById) {
    decoders.set(id, [channel.topic, decoder(reader.schemasById.get(channel.schemaId))]);
  }
  const tally = new Tally();
  for await (const message of reader.readMessages({ validateCrcs: true })) {
    tally.add(...decoders.get(message.channelId), message);
  }
  const metadata = [];
  for await (const record of reader.readMetadata()) metadata.push(record.name);
  const attachments = {};
  for await (const record of reader.readAttachments({ validateCrcs: true })) {
    attachments[record.name] = record.data.length;
  }
  await source.close();
  return { ...tally, profile: reader.header.profile, metadata, attachments };
}

async function fromFrontToBack(path) {
  const reader = new McapStreamReader({ decompressHandlers, validateCrcs: true });
  const schemas = new Map();
  const decoders = new Map();
  const tally = new Tally();
  reader.append(await readFile(path));
  for (let record; (record = reader.nextRecord()); ) {
    if (record.type === "Schema") schemas.set(record.id, record);
    if (record.type === "Channel" && !decoders.has(record.id)) {
      decoders.set(record.id, [record.topic, decoder(schemas.get(record.schemaId))]);
    }
    if (record.type === "Message") tally.add(...decoders.get(record.channelId), record);
  }
  return { ...tally, done: reader.done() };
}

const found = [];
for (const path of process.argv.slice(2)) {
  found.push({ index: await byIndex(path), stream: await fromFrontToBack(path) });
}
process.stdout.write(JSON.stringify(found));
