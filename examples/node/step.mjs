// Steps a batch and a sample of a running simulator, and saves its images.
//
//   node step.mjs [--address 127.0.0.1:50051] [--out out] [--seed 7] [--position 0,0,6]
//
// Written from simulator.proto alone. Prints one line of JSON for each frame.
import { createHash, randomUUID } from "node:crypto";
import { mkdirSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { parseArgs } from "node:util";

import grpc from "@grpc/grpc-js";

import { decoded, isInline } from "./arrays.mjs";
import { fieldViolations } from "./errors.mjs";
import { loadContract } from "./contract.mjs";

const HERE = dirname(fileURLToPath(import.meta.url));
const PROTO_ROOT = join(HERE, "..", "..", "oaisys_grpc", "proto");
const DEADLINE_MS = 120_000;

// A body whose x axis points straight down, so that its camera does.
const LOOKING_DOWN = { x: 0, y: Math.SQRT1_2, z: 0, w: Math.SQRT1_2 };

function deadline() {
  return { deadline: Date.now() + DEADLINE_MS };
}

/** Call a unary method; resolves to its response. */
function call(client, method, request) {
  return new Promise((resolve, reject) => {
    client[method](request, deadline(), (error, response) => (error ? reject(error) : resolve(response)));
  });
}

/** Wait until an operation has ended; a failed one throws. */
async function ended(client, operation) {
  let last = operation;
  for await (const { operation: now } of client.WatchOperation({ name: operation.name }, deadline())) {
    last = now;
  }
  if (last.state !== "OPERATION_STATE_SUCCEEDED") {
    const { reason, message, field } = last.error;
    throw new Error(`${last.name} ${reason}${field ? ` (${field})` : ""}: ${message}`);
  }
  return last;
}

/** Fetch a sample: its header, and its frames with their encoded bytes. */
async function fetchSample(client, batchId, sampleId) {
  const transfer = {
    accepted_encodings: ["ENCODING_PNG", "ENCODING_SHUFFLED_ZLIB"],
    max_inline_bytes: 65536,
  };
  const request = { batch_id: batchId, sample_id: sampleId, transfer };
  let header;
  const frames = [];
  for await (const { part } of client.GetSample(request, deadline())) {
    if (part.part === "sample") {
      header = part.sample;
    } else if (part.part === "frame") {
      const size = part.frame.array.byte_size;
      frames.push({ ...part.frame, bytes: isInline(part.frame) ? part.frame.data : Buffer.alloc(size) });
    } else if (part.part === "chunk") {
      part.chunk.data.copy(frames.at(-1).bytes, part.chunk.offset);
    }
  }
  return { header, frames };
}

/** Save a frame as an image where there is a simple one, and return what to tell of it. */
function save(frame, folder) {
  const { array, sensor, modality, bytes } = frame;
  const told = { sensor, modality, shape: array.shape, encoding: array.encoding, bytes: bytes.length };
  const path = (ending) => join(folder, `${sensor}_${modality}.${ending}`);
  if (array.encoding === "ENCODING_PNG") {
    writeFileSync(path("png"), bytes);
    return told;
  }
  const raw = decoded(array, bytes);
  told.sha256 = createHash("sha256").update(raw).digest("hex");
  const [height, width] = array.shape;
  if (modality === "rgb") {
    writeFileSync(path("ppm"), Buffer.concat([Buffer.from(`P6\n${width} ${height}\n255\n`), raw]));
  } else if (modality === "depth") {
    const depths = Array.from({ length: width * height }, (_, i) => raw.readFloatLE(4 * i));
    const hits = depths.filter(Number.isFinite);
    told.nearest_m = hits.reduce((a, b) => Math.min(a, b), Infinity);
    told.farthest_m = hits.reduce((a, b) => Math.max(a, b), -Infinity);
    writeFileSync(path("f32"), raw);
  }
  return told;
}

async function main() {
  const { values } = parseArgs({
    options: {
      address: { type: "string", default: "127.0.0.1:50051" },
      out: { type: "string", default: "out" },
      seed: { type: "string" },
      position: { type: "string", default: "0,0,6" },
    },
  });
  const [x, y, z] = values.position.split(",").map(Number);
  mkdirSync(values.out, { recursive: true });

  const { SimulatorService } = loadContract(PROTO_ROOT, "oaisys/v1/simulator.proto");
  const client = new SimulatorService(values.address, grpc.credentials.createInsecure());
  try {
    const info = await call(client, "GetSimulatorInfo", {});
    console.error(`${info.backend} ${info.backend_version}, ${info.sensors.length} sensor(s)`);

    const seed = values.seed === undefined ? {} : { seed: values.seed };
    const batch = await call(client, "StepBatch", { request_id: randomUUID(), ...seed });
    await ended(client, batch.operation);

    const pose = { position_m: { x, y, z }, orientation: LOOKING_DOWN };
    const step = { request_id: randomUUID(), metadata: { sensor: { pose } } };
    const sample = await call(client, "StepSample", step);
    const { batch_id, sample_id } = await ended(client, sample.operation);

    const { header, frames } = await fetchSample(client, batch_id, sample_id);
    console.error(`sample ${header.sample_id} of batch ${header.batch_id}: ${header.frame_count} frames`);
    for (const frame of frames) {
      console.log(JSON.stringify(save(frame, values.out)));
    }
  } finally {
    client.close();
  }
}

main().catch((error) => {
  console.error(`failed: ${error.message}`);
  for (const { field, description } of fieldViolations(error)) {
    console.error(`  ${field}: ${description}`);
  }
  process.exitCode = 1;
});
