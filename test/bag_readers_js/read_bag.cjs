// SPDX-License-Identifier: Apache-2.0
// Reads an MCAP file as a web page would, and prints one line of JSON per message.
// node read_bag.cjs FOLDER_OF_NODE_MODULES FILE.mcap
"use strict";
const fs = require("node:fs/promises");
const path = require("node:path");
const { createRequire } = require("node:module");

const [folder, file] = process.argv.slice(2);
const load = createRequire(path.join(path.resolve(folder), "index.js"));
const { McapIndexedReader } = load("@mcap/core");
const { parse } = load("@foxglove/rosmsg");
const { MessageReader } = load("@foxglove/rosmsg2-serialization");

// JSON has no -0: numbers go out as the hexadecimal digits of their 64 bits.
function bits(values) {
  return Array.from(values ?? [], (value) => {
    const buffer = Buffer.alloc(8);
    buffer.writeDoubleBE(value);
    return buffer.toString("hex");
  });
}

async function main() {
  const handle = await fs.open(file);
  const readable = {
    size: async () => BigInt((await handle.stat()).size),
    read: async (offset, length) => {
      const data = new Uint8Array(Number(length));
      await handle.read(data, 0, data.length, Number(offset));
      return data;
    },
  };
  const reader = await McapIndexedReader.Initialize({ readable });
  const decoders = new Map();
  for (const channel of reader.channelsById.values()) {
    const schema = reader.schemasById.get(channel.schemaId);
    const text = new TextDecoder().decode(schema.data);
    const definition = parse(text, { ros2: true });
    decoders.set(channel.id, new MessageReader(definition));
  }
  for await (const message of reader.readMessages()) {
    const channel = reader.channelsById.get(message.channelId);
    const decoded = decoders.get(message.channelId).readMessage(message.data);
    const stamp = decoded.header?.stamp;
    console.log(
      JSON.stringify({
        topic: channel.topic,
        type: reader.schemasById.get(channel.schemaId).name,
        time: String(message.logTime),
        stamp: stamp ? String(BigInt(stamp.sec) * 1000000000n + BigInt(stamp.nanosec)) : null,
        text: typeof decoded.data === "string" ? decoded.data : null,
        name: decoded.name ?? null,
        data: typeof decoded.data === "string" ? [] : bits(decoded.data),
        position: bits(decoded.position),
        velocity: bits(decoded.velocity),
        effort: bits(decoded.effort),
      }),
    );
  }
  await handle.close();
}

main().catch((error) => {
  console.error(error);
  process.exit(1);
});
