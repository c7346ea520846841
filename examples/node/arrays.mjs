// Turns the bytes of a frame into the bytes of its array: little-endian, row by row.
import { inflateSync } from "node:zlib";

const ITEM_BYTES = {
  DATA_TYPE_UINT8: 1,
  DATA_TYPE_UINT16: 2,
  DATA_TYPE_UINT32: 4,
  DATA_TYPE_INT32: 4,
  DATA_TYPE_FLOAT32: 4,
  DATA_TYPE_FLOAT64: 8,
};

/** Whether a frame brought its bytes along, so that no chunks follow. */
export function isInline(frame) {
  return frame.content === "data";
}

/** The raw bytes of an array that came raw or as shuffled zlib. */
export function decoded(array, bytes) {
  const item = ITEM_BYTES[array.data_type];
  const count = array.shape.reduce((a, b) => a * b, 1);
  if (array.encoding === "ENCODING_RAW") {
    return bytes;
  }
  if (array.encoding !== "ENCODING_SHUFFLED_ZLIB") {
    throw new Error(`cannot decode ${array.encoding}`);
  }
  // First the first byte of every element, then the second one of every element, and so on.
  const planes = inflateSync(bytes, { maxOutputLength: count * item });
  const raw = Buffer.alloc(count * item);
  for (let s = 0; s < item; s++) {
    for (let n = 0; n < count; n++) {
      raw[n * item + s] = planes[s * count + n];
    }
  }
  return raw;
}
