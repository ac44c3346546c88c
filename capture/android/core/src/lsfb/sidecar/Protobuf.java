package lsfb.sidecar;

import java.io.ByteArrayOutputStream;
import java.nio.ByteBuffer;
import java.nio.ByteOrder;
import java.nio.charset.StandardCharsets;

/** The part of the protobuf wire format that the protocol needs. Fields that are zero or empty are left out. */
final class Protobuf {
  private final ByteArrayOutputStream out = new ByteArrayOutputStream();

  Protobuf number(int field, long value) {
    if (value != 0) {
      varint((long) field << 3);
      varint(value);
    }
    return this;
  }

  Protobuf bytes(int field, byte[] value) {
    if (value.length > 0) {
      varint((long) field << 3 | 2);
      varint(value.length);
      out.write(value, 0, value.length);
    }
    return this;
  }

  Protobuf text(int field, String value) {
    return bytes(field, value.getBytes(StandardCharsets.UTF_8));
  }

  Protobuf fixed32(int field, int value) {
    if (value != 0) {
      varint((long) field << 3 | 5);
      for (int shift = 0; shift < 32; shift += 8) {
        out.write(value >>> shift);
      }
    }
    return this;
  }

  byte[] done() {
    return out.toByteArray();
  }

  private void varint(long value) {
    long rest = value;
    while ((rest & ~0x7FL) != 0) {
      out.write((int) (rest & 0x7F | 0x80));
      rest >>>= 7;
    }
    out.write((int) rest);
  }

  /** Fields in the order of their bytes. */
  static final class Reader {
    private final ByteBuffer in;
    int field;
    long number;
    byte[] bytes = new byte[0];

    Reader(byte[] message) {
      in = ByteBuffer.wrap(message).order(ByteOrder.LITTLE_ENDIAN);
    }

    /** Whether there is another field; it is then in {@link #field} with its value. */
    boolean next() throws ProtocolException {
      if (!in.hasRemaining()) {
        return false;
      }
      long key = varint();
      field = (int) (key >>> 3);
      switch ((int) (key & 7)) {
        case 0:
          number = varint();
          return true;
        case 1:
          need(8);
          number = in.getLong();
          return true;
        case 2:
          long length = varint();
          if (length < 0 || length > in.remaining()) {
            throw new ProtocolException("a field is longer than its message");
          }
          bytes = new byte[(int) length];
          in.get(bytes);
          return true;
        case 5:
          need(4);
          number = in.getInt() & 0xFFFFFFFFL;
          return true;
        default:
          throw new ProtocolException("a field of unknown type");
      }
    }

    private long varint() throws ProtocolException {
      long value = 0;
      for (int shift = 0; shift < 64; shift += 7) {
        need(1);
        byte b = in.get();
        value |= (long) (b & 0x7F) << shift;
        if (b >= 0) {
          return value;
        }
      }
      throw new ProtocolException("a number of more than 64 bits");
    }

    private void need(int bytes) throws ProtocolException {
      if (in.remaining() < bytes) {
        throw new ProtocolException("a message ends inside a field");
      }
    }
  }
}
