package lsfb.sidecar;

import java.nio.ByteBuffer;
import java.nio.ByteOrder;
import java.nio.charset.StandardCharsets;

/** Little-endian CDR as ROS 2 writes it: numbers stand at multiples of their size, counted after four bytes that say so. */
final class Cdr {
  private static final int ENCAPSULATION_BYTES = 4;
  private ByteBuffer out;

  Cdr(int aboutBytes) {
    out = ByteBuffer.allocate(aboutBytes + 64).order(ByteOrder.LITTLE_ENDIAN);
    out.put(new byte[] {0, 1, 0, 0});
  }

  Cdr header(long timeNs, String frame) {
    return u32((int) Math.floorDiv(timeNs, 1_000_000_000L))
        .u32((int) Math.floorMod(timeNs, 1_000_000_000L))
        .text(frame);
  }

  Cdr u8(int value) {
    room(1, 1).put((byte) value);
    return this;
  }

  Cdr u16(int value) {
    room(2, 2).putShort((short) value);
    return this;
  }

  Cdr u32(int value) {
    room(4, 4).putInt(value);
    return this;
  }

  Cdr u64(long value) {
    room(8, 8).putLong(value);
    return this;
  }

  Cdr f64(double... values) {
    for (double value : values) {
      room(8, 8).putDouble(value);
    }
    return this;
  }

  Cdr text(String value) {
    byte[] bytes = value.getBytes(StandardCharsets.UTF_8);
    u32(bytes.length + 1);
    room(bytes.length + 1, 1).put(bytes).put((byte) 0);
    return this;
  }

  Cdr bytes(byte[] value) {
    u32(value.length);
    room(value.length, 1).put(value);
    return this;
  }

  byte[] done() {
    byte[] bytes = new byte[out.position()];
    out.flip();
    out.get(bytes);
    return bytes;
  }

  private ByteBuffer room(int bytes, int alignment) {
    while ((out.position() - ENCAPSULATION_BYTES) % alignment != 0) {
      out.put((byte) 0);
    }
    if (out.remaining() < bytes + 16) {
      ByteBuffer larger = ByteBuffer.allocate(2 * out.capacity() + bytes).order(ByteOrder.LITTLE_ENDIAN);
      out.flip();
      out = larger.put(out);
    }
    return out;
  }
}
