package lsfb.sidecar;

/** One WebSocket message of protocol {@code lsfb.sidecar.v1} (docs/sidecar.md). */
public final class Envelope {
  public static final int HELLO = 1;
  public static final int ADVERTISE = 2;
  public static final int DATA = 3;
  public static final int ACK = 4;
  public static final int CREDIT = 5;
  public static final int TIME_REQUEST = 6;
  public static final int TIME_RESPONSE = 7;
  public static final int STATE = 8;
  public static final int BYE = 9;
  /** Largest, bytes. */
  public static final int MAX_BYTES = 4 << 20;

  private static final byte[] NOTHING = new byte[0];

  public final int type;
  public final int channel;
  public final long seq;
  public final long deviceTimeNs;
  public final byte[] payload;

  public Envelope(int type, int channel, long seq, long deviceTimeNs, byte[] payload) {
    this.type = type;
    this.channel = channel;
    this.seq = seq;
    this.deviceTimeNs = deviceTimeNs;
    this.payload = payload;
  }

  static Envelope bare(int type, long seq) {
    return new Envelope(type, 0, seq, 0, NOTHING);
  }

  static Envelope around(int type, byte[] payload) {
    return new Envelope(type, 0, 0, 0, payload);
  }

  public byte[] emit() {
    int crc = payload.length == 0 ? 0 : Crc32c.of(payload);
    return new Protobuf()
        .number(1, type)
        .number(2, channel)
        .number(3, seq)
        .number(4, deviceTimeNs)
        .bytes(5, payload)
        .fixed32(6, crc)
        .done();
  }

  public static Envelope parse(byte[] message) throws ProtocolException {
    int type = 0;
    int channel = 0;
    long seq = 0;
    long deviceTimeNs = 0;
    byte[] payload = NOTHING;
    int crc = 0;
    Protobuf.Reader fields = new Protobuf.Reader(message);
    while (fields.next()) {
      switch (fields.field) {
        case 1: type = (int) fields.number; break;
        case 2: channel = (int) fields.number; break;
        case 3: seq = fields.number; break;
        case 4: deviceTimeNs = fields.number; break;
        case 5: payload = fields.bytes; break;
        case 6: crc = (int) fields.number; break;
        // Of a later version.
        default: break;
      }
    }
    if (payload.length > 0 && crc != Crc32c.of(payload)) {
      throw new ProtocolException("a payload is damaged");
    }
    return new Envelope(type, channel, seq, deviceTimeNs, payload);
  }
}
