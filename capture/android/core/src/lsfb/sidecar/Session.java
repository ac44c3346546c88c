package lsfb.sidecar;

import java.io.IOException;
import java.util.ArrayList;
import java.util.List;

/**
 * What is said to the rig and when: a state machine without a network. It outlives its connections: what the rig has not stored is in the
 * {@link Spool}, and each new connection goes on where the rig has got to.
 */
public final class Session {
  private static final int EAGER_EXCHANGES = 10;
  private static final long EAGER_NS = 50_000_000L;
  private static final long CALM_NS = 1_000_000_000L;

  private final String name;
  private final String device;
  private final byte[] key;
  private final Spool spool;
  private final String clockId;
  private final List<Channel> channels = new ArrayList<>();

  private byte[] token;
  private boolean isGreeted;
  private int described;
  private long sent;
  private long sentBytes;
  private long credit;
  private int exchanges;
  private long askedNs;
  private long[] last = new long[4];
  private boolean saidBye;

  /** A token of no bytes: this phone is paired already. */
  public Session(String name, String device, byte[] key, byte[] token, Spool spool, String clockId) {
    this.name = name;
    this.device = device;
    this.key = key.clone();
    this.token = token.clone();
    this.spool = spool;
    this.clockId = clockId;
  }

  /** Adds a channel; its DATA may be spooled from now on. */
  public synchronized void describe(Channel channel) {
    channels.add(channel);
  }

  /** Measured: numbered and kept. */
  public synchronized void measured(int channel, long deviceTimeNs, byte[] payload) throws IOException {
    spool.put(new Envelope(Envelope.DATA, channel, spool.lastSeq() + 1, deviceTimeNs, payload));
  }

  /** What to say first on a new connection. */
  public synchronized byte[] opened() {
    isGreeted = false;
    described = 0;
    sentBytes = 0;
    credit = 0;
    exchanges = 0;
    askedNs = 0;
    last = new long[4];
    saidBye = false;
    byte[] hello =
        new Protobuf()
            .text(1, name)
            .number(2, spool.firstUnacknowledged())
            .text(3, device)
            .bytes(4, key)
            .bytes(5, token)
            .done();
    return Envelope.around(Envelope.HELLO, hello).emit();
  }

  /** Hears one message of the rig, which arrived at {@code nowNs} of the clock that stamps the sensors. */
  public synchronized void heard(byte[] message, long nowNs) throws IOException {
    Envelope said = Envelope.parse(message);
    switch (said.type) {
      case Envelope.ACK:
        spool.acknowledge(said.seq);
        if (!isGreeted) {
          isGreeted = true;
          // The rig knows the key now.
          token = new byte[0];
          sent = said.seq;
        }
        sent = Math.max(sent, said.seq);
        break;
      case Envelope.CREDIT:
        credit = Math.max(credit, said.seq);
        break;
      case Envelope.TIME_RESPONSE:
        long[] times = new long[4];
        Protobuf.Reader fields = new Protobuf.Reader(said.payload);
        while (fields.next()) {
          if (fields.field >= 1 && fields.field <= 3) {
            times[fields.field - 1] = fields.number;
          }
        }
        times[3] = nowNs;
        last = times;
        exchanges++;
        break;
      case Envelope.STATE:
        throw refusal(said.payload);
      default:
        throw new ProtocolException("the rig sent a message that only a phone may send");
    }
  }

  /** The next message to send, or null: wait until something is heard or measured. Time goes before everything that waits. */
  public synchronized byte[] next(long nowNs, boolean isEnding) throws IOException {
    if (!isGreeted || credit == 0) {
      return null;
    }
    if (described < channels.size()) {
      return Envelope.around(Envelope.ADVERTISE, channels.get(described++).emit()).emit();
    }
    long pause = exchanges < EAGER_EXCHANGES ? EAGER_NS : CALM_NS;
    if (askedNs == 0 || nowNs - askedNs >= pause) {
      askedNs = nowNs;
      return timeRequest(nowNs);
    }
    byte[] data = sent < spool.syncedSeq() ? spool.read(sent + 1) : null;
    if (data != null && sentBytes + data.length <= credit) {
      sent++;
      sentBytes += data.length;
      return data;
    }
    if (isEnding && data == null && sent == spool.lastSeq() && !saidBye) {
      saidBye = true;
      return Envelope.bare(Envelope.BYE, sent).emit();
    }
    return null;
  }

  /** Whether the rig has everything. */
  public synchronized boolean isStored() {
    return spool.firstUnacknowledged() > spool.lastSeq();
  }

  private byte[] timeRequest(long nowNs) {
    byte[] request =
        new Protobuf()
            .number(1, nowNs)
            .text(2, clockId)
            .number(3, last[0])
            .number(4, last[1])
            .number(5, last[2])
            .number(6, last[3])
            .done();
    return Envelope.around(Envelope.TIME_REQUEST, request).emit();
  }

  private static Refusal refusal(byte[] state) throws ProtocolException {
    int code = 0;
    String text = "";
    Protobuf.Reader fields = new Protobuf.Reader(state);
    while (fields.next()) {
      if (fields.field == 1) {
        code = (int) fields.number;
      } else if (fields.field == 2) {
        text = new String(fields.bytes, java.nio.charset.StandardCharsets.UTF_8);
      }
    }
    return new Refusal(code, text);
  }
}
