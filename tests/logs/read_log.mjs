// Prints each message of a log as a line of JSON, as @mcap/core and @foxglove/rosmsg2-serialization read it.
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { join } from "node:path";
import { pathToFileURL } from "node:url";

const [log, folder] = process.argv.slice(2);
const load = createRequire(join(folder, "package.json"));
const { McapStreamReader } = await import(pathToFileURL(load.resolve("@mcap/core")));
const { parse } = load("@foxglove/rosmsg");
const { MessageReader } = load("@foxglove/rosmsg2-serialization");
const { decompress } = load("fzstd");

// JSON knows no numbers that are none, nor whole ones of 64 bits, nor typed arrays.
const plain = (key, value) => {
  if (typeof value === "bigint") return Number(value);
  if (typeof value === "number" && !Number.isFinite(value)) return `${value}`;
  return ArrayBuffer.isView(value) ? Array.from(value) : value;
};

const schemas = new Map(), channels = new Map();
const reader = new McapStreamReader({
  validateCrcs: true,
  decompressHandlers: { zstd: (data, size) => decompress(data, new Uint8Array(Number(size))) },
});
reader.append(readFileSync(log));
for (let record; (record = reader.nextRecord()); ) {
  if (record.type === "Schema") {
    const definition = parse(new TextDecoder().decode(record.data), { ros2: true });
    schemas.set(record.id, new MessageReader(definition));
  } else if (record.type === "Channel") {
    channels.set(record.id, record);
  } else if (record.type === "Message") {
    const { topic, schemaId } = channels.get(record.channelId);
    const decoder = schemas.get(schemaId);
    const message = decoder.readMessage(record.data);
    if (decoder.lastReadHadTrailingBytes()) throw new Error(`${topic}: bytes are left over`);
    console.log(JSON.stringify([topic, record.logTime, message], plain));
  }
}
if (!reader.done()) throw new Error("the log does not end");
