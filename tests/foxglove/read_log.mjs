// Reads a whole log with the libraries that Foxglove and Lichtblick are made of: index, chunks, schemas, every message.
// Usage: node read_log.mjs run.mcap. Exit code 1 and a message where they find something else than the log says it holds.

import assert from "node:assert/strict";
import { open } from "node:fs/promises";

import rosmsg from "@foxglove/rosmsg";
import rosmsg2 from "@foxglove/rosmsg2-serialization";
import { McapIndexedReader } from "@mcap/core";
import { FileHandleReadable } from "@mcap/nodejs";
import { loadDecompressHandlers } from "@mcap/support";

const file = await open(process.argv[2], "r");
const reader = await McapIndexedReader.Initialize({
  readable: new FileHandleReadable(file),
  decompressHandlers: await loadDecompressHandlers(),
});

function makeDecoder(channel) {
  const text = new TextDecoder().decode(reader.schemasById.get(channel.schemaId).data);
  if (channel.messageEncoding === "json") {
    const required = JSON.parse(text).required ?? [];
    return (data) => {
      const message = JSON.parse(new TextDecoder().decode(data));
      for (const name of required) assert.ok(name in message, `${channel.topic}: ${name} is missing`);
      return message;
    };
  }
  assert.equal(channel.messageEncoding, "cdr", channel.topic);
  const decoder = new rosmsg2.MessageReader(rosmsg.parse(text, { ros2: true }));
  return (data) => decoder.readMessage(data);
}

const decoders = new Map([...reader.channelsById].map(([id, channel]) => [id, makeDecoder(channel)]));
const counts = new Map();
let time = -1n;
for await (const message of reader.readMessages()) {
  assert.ok(message.logTime >= time, "messages come in the order of their log times");
  time = message.logTime;
  const { stamp, ...values } = decoders.get(message.channelId)(message.data);
  if (stamp) assert.equal(BigInt(stamp.sec) * 1_000_000_000n + BigInt(stamp.nsec ?? stamp.nanosec), message.logTime);
  for (const value of Object.values(values).flatMap((v) => (ArrayBuffer.isView(v) ? Array.from(v) : v))) {
    assert.ok(typeof value !== "number" || Number.isFinite(value), `${message.channelId}: ${value}`);
  }
  counts.set(message.channelId, (counts.get(message.channelId) ?? 0n) + 1n);
}
assert.deepEqual(counts, new Map([...reader.statistics.channelMessageCounts].filter(([, count]) => count > 0n)));
for await (const attachment of reader.readAttachments()) assert.ok(attachment.data.byteLength > 0, attachment.name);
await file.close();
console.log(`Foxglove's libraries read ${reader.statistics.messageCount} messages on ${counts.size} topics`);
