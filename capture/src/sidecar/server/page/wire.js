// Envelopes of protocol lsfb.sidecar.v1 and the messages inside (docs/sidecar.md), and the payloads: CDR, little-endian.

export const KIND = { hello: 1, advertise: 2, data: 3, ack: 4, credit: 5, timeRequest: 6, timeResponse: 7, state: 8, bye: 9 };

const CRC_TABLE = Uint32Array.from({ length: 256 }, (_, n) => {
  let crc = n;
  for (let bit = 0; bit < 8; bit += 1) crc = crc & 1 ? (crc >>> 1) ^ 0x82f63b78 : crc >>> 1;
  return crc >>> 0;
});

function crc32c(bytes) {
  let crc = 0xffffffff;
  for (const byte of bytes) crc = CRC_TABLE[(crc ^ byte) & 0xff] ^ (crc >>> 8);
  return (crc ^ 0xffffffff) >>> 0;
}

// Numbers are BigInt where they may exceed 2^53: nanoseconds.
class Fields {
  parts = [];

  varint(field, value) {
    const big = BigInt.asUintN(64, BigInt(value));
    if (big !== 0n) this.parts.push(varint(BigInt(field << 3)), varint(big));
    return this;
  }

  bytes(field, value) {
    if (value.length > 0) this.parts.push(varint(BigInt((field << 3) | 2)), varint(BigInt(value.length)), value);
    return this;
  }

  text(field, value) {
    return this.bytes(field, new TextEncoder().encode(value));
  }

  fixed32(field, value) {
    if (value !== 0) {
      const bytes = new Uint8Array(4);
      new DataView(bytes.buffer).setUint32(0, value, true);
      this.parts.push(varint(BigInt((field << 3) | 5)), bytes);
    }
    return this;
  }

  done() {
    const all = new Uint8Array(this.parts.reduce((sum, part) => sum + part.length, 0));
    let at = 0;
    for (const part of this.parts) {
      all.set(part, at);
      at += part.length;
    }
    return all;
  }
}

function varint(value) {
  const bytes = [];
  let rest = value;
  while (rest >= 0x80n) {
    bytes.push(Number(rest & 0x7fn) | 0x80);
    rest >>= 7n;
  }
  bytes.push(Number(rest));
  return Uint8Array.from(bytes);
}

// The fields of a message by their numbers: BigInt or Uint8Array.
function fieldsOf(bytes) {
  const fields = new Map();
  let at = 0;
  const next = () => {
    let value = 0n;
    for (let shift = 0n; shift < 70n; shift += 7n) {
      if (at >= bytes.length) break;
      const byte = bytes[at++];
      value |= BigInt(byte & 0x7f) << shift;
      if (byte < 0x80) return BigInt.asUintN(64, value);
    }
    throw new Error("a number that does not end");
  };
  while (at < bytes.length) {
    const key = Number(next());
    const length = { 0: () => 0, 1: () => 8, 2: () => Number(next()), 5: () => 4 }[key & 7];
    if (!length) throw new Error("an unknown kind of field");
    if ((key & 7) === 0) {
      fields.set(key >> 3, next());
      continue;
    }
    const size = length();
    const end = at + size;
    if (end > bytes.length) throw new Error("a field that is cut off");
    fields.set(key >> 3, bytes.subarray(at, end));
    at = end;
  }
  return fields;
}

export function envelope(kind, { channel = 0, seq = 0, deviceNs = 0n, payload = new Uint8Array() } = {}) {
  return new Fields()
    .varint(1, kind)
    .varint(2, channel)
    .varint(3, seq)
    .varint(4, deviceNs)
    .bytes(5, payload)
    .fixed32(6, payload.length > 0 ? crc32c(payload) : 0)
    .done();
}

export function parseEnvelope(bytes) {
  const fields = fieldsOf(bytes);
  const payload = fields.get(5) ?? new Uint8Array();
  return { kind: Number(fields.get(1) ?? 0n), seq: Number(fields.get(3) ?? 0n), payload };
}

export function hello({ session, firstUnacked, device, key, token }) {
  const fields = new Fields().text(1, session).varint(2, firstUnacked).text(3, device).bytes(4, key);
  return (token ? fields.bytes(5, token) : fields).done();
}

export function advertise({ channel, topic, schemaName, schema, clockId }) {
  return new Fields()
    .varint(1, channel)
    .text(2, topic)
    .text(3, "cdr")
    .text(4, schemaName)
    .text(5, schema)
    .text(6, clockId)
    .text(7, "{}")
    .done();
}

export function timeRequest(t1, clockId, last) {
  const fields = new Fields().varint(1, t1).text(2, clockId);
  if (last) fields.varint(3, last.t1).varint(4, last.t2).varint(5, last.t3).varint(6, last.t4);
  return fields.done();
}

export function parseTimeResponse(payload) {
  const fields = fieldsOf(payload);
  return { t1: fields.get(1) ?? 0n, t2: fields.get(2) ?? 0n, t3: fields.get(3) ?? 0n };
}

export function parseState(payload) {
  const fields = fieldsOf(payload);
  const text = new TextDecoder().decode(fields.get(2) ?? new Uint8Array());
  return { code: Number(fields.get(1) ?? 0n), text };
}

// CDR: every number stands at a multiple of its size, counted from behind the four bytes that say so.
class Cdr {
  constructor(bytes) {
    this.bytes = new Uint8Array(bytes + 4);
    this.view = new DataView(this.bytes.buffer);
    this.bytes[1] = 1;
    this.at = 4;
  }

  align(size) {
    this.at = 4 + Math.ceil((this.at - 4) / size) * size;
  }

  u8(value) {
    this.bytes[this.at++] = value;
  }

  u32(value) {
    this.align(4);
    this.view.setUint32(this.at, value, true);
    this.at += 4;
  }

  f64(...values) {
    this.align(8);
    for (const value of values) {
      this.view.setFloat64(this.at, value, true);
      this.at += 8;
    }
  }

  text(value) {
    const bytes = new TextEncoder().encode(value);
    this.u32(bytes.length + 1);
    this.bytes.set(bytes, this.at);
    this.at += bytes.length + 1;
  }

  header(timeNs, frame) {
    this.u32(Number(timeNs / 1_000_000_000n));
    this.u32(Number(timeNs % 1_000_000_000n));
    this.text(frame);
  }

  done() {
    return this.bytes.slice(0, this.at);
  }
}

// sensor_msgs/msg/Image of one byte a pixel.
export function image(timeNs, frame, width, height, grey) {
  const cdr = new Cdr(grey.length + 128);
  cdr.header(timeNs, frame);
  cdr.u32(height);
  cdr.u32(width);
  cdr.text("mono8");
  cdr.u8(0);
  cdr.u32(width);
  cdr.u32(grey.length);
  cdr.bytes.set(grey, cdr.at);
  cdr.at += grey.length;
  return cdr.done();
}

const UNKNOWN = [0, 0, 0, 0, 0, 0, 0, 0, 0];

// sensor_msgs/msg/Imu without orientation, which its covariance says by -1.
export function imu(timeNs, frame, angularVelocityRadS, specificForceMS2) {
  const cdr = new Cdr(512);
  cdr.header(timeNs, frame);
  cdr.f64(0, 0, 0, 1, -1, ...UNKNOWN.slice(1));
  cdr.f64(...angularVelocityRadS, ...UNKNOWN);
  cdr.f64(...specificForceMS2, ...UNKNOWN);
  return cdr.done();
}
