// Prints, for each file named, what @mcap/core finds: messages by topic, attachments, metadata; or the error.
import { open, readFile } from "node:fs/promises";
import { McapIndexedReader, McapStreamReader } from "@mcap/core";
import { decompress } from "fzstd";
import lz4 from "lz4js";

const decompressHandlers = {
  zstd: (packed, size) => decompress(packed, new Uint8Array(Number(size))),
  lz4: (packed, size) => lz4.decompress(packed, Number(size)),
};

async function indexed(path) {
  const file = await open(path);
  try {
    const readable = {
      size: async () => BigInt((await file.stat()).size),
      read: async (offset, length) => {
        const buffer = new Uint8Array(Number(length));
        await file.read(buffer, 0, Number(length), Number(offset));
        return buffer;
      },
    };
    const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
    const found = { topics: {}, attachments: 0, metadata: 0 };
    for await (const message of reader.readMessages()) {
      const { topic } = reader.channelsById.get(message.channelId);
      found.topics[topic] = (found.topics[topic] ?? 0) + 1;
    }
    for await (const _ of reader.readAttachments()) found.attachments++;
    for await (const _ of reader.readMetadata()) found.metadata++;
    return found;
  } finally {
    await file.close();
  }
}

async function streamed(path) {
  const reader = new McapStreamReader({ decompressHandlers });
  reader.append(await readFile(path));
  const found = { topics: {}, attachments: 0, metadata: 0 };
  const topics = new Map();
  for (let record; (record = reader.nextRecord()); ) {
    if (record.type === "Channel") topics.set(record.id, record.topic);
    if (record.type === "Message") {
      const topic = topics.get(record.channelId);
      found.topics[topic] = (found.topics[topic] ?? 0) + 1;
    }
    if (record.type === "Attachment") found.attachments++;
    if (record.type === "Metadata") found.metadata++;
  }
  return found;
}

const answers = {};
for (const path of process.argv.slice(2)) {
  answers[path] = {};
  for (const [name, read] of Object.entries({ indexed, streamed })) {
    try {
      answers[path][name] = await read(path);
    } catch (error) {
      answers[path][name] = { error: String(error.message) };
    }
  }
}
console.log(JSON.stringify(answers));
