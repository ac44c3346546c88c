package lsfb.sidecar;

import java.io.IOException;
import java.util.concurrent.atomic.AtomicReference;
import java.util.function.LongSupplier;

/** A session kept connected: one thread sends, one hears; whatever is lost is tried again with growing pauses. */
public final class Phone implements Runnable {
  private static final long FIRST_PAUSE_MS = 200;
  private static final long LONGEST_PAUSE_MS = 5_000;
  private static final long IDLE_MS = 5;
  /** How often the spool is put to the disk. */
  private static final long SYNC_NS = 200_000_000L;

  private final Session session;
  private final Spool spool;
  private final PairingCode rig;
  private final LongSupplier clockNs;
  private volatile boolean isEnding;
  private volatile Refusal refusal;

  public Phone(Session session, Spool spool, PairingCode rig, LongSupplier clockNs) {
    this.session = session;
    this.spool = spool;
    this.rig = rig;
    this.clockNs = clockNs;
  }

  /** Nothing follows: {@link #run} ends when the rig has everything. */
  public void end() {
    isEnding = true;
  }

  /** Why the rig does not want this phone; null where it does, or may later. */
  public Refusal refusal() {
    return refusal;
  }

  @Override
  public void run() {
    long pauseMs = FIRST_PAUSE_MS;
    while (!(isEnding && session.isStored())) {
      try {
        connected();
        pauseMs = FIRST_PAUSE_MS;
      } catch (Refusal e) {
        if (!e.mayPass()) {
          refusal = e;
          return;
        }
      } catch (IOException e) {
        // The network is away, or the rig: both come back.
      }
      if (isEnding && session.isStored()) {
        return;
      }
      try {
        Thread.sleep(pauseMs);
      } catch (InterruptedException e) {
        return;
      }
      pauseMs = Math.min(2 * pauseMs, LONGEST_PAUSE_MS);
    }
  }

  private void connected() throws IOException {
    AtomicReference<IOException> lost = new AtomicReference<>();
    try (WebSocket socket = new WebSocket(rig)) {
      socket.send(session.opened());
      Thread hearing =
          new Thread(
              () -> {
                try {
                  while (true) {
                    byte[] message = socket.receive();
                    session.heard(message, clockNs.getAsLong());
                  }
                } catch (IOException e) {
                  lost.compareAndSet(null, e);
                }
              },
              "sidecar-hear");
      hearing.setDaemon(true);
      hearing.start();
      long syncedNs = 0;
      while (lost.get() == null && !(isEnding && session.isStored())) {
        long nowNs = clockNs.getAsLong();
        if (nowNs - syncedNs >= SYNC_NS) {
          spool.sync();
          syncedNs = nowNs;
        }
        byte[] message = session.next(clockNs.getAsLong(), isEnding);
        if (message == null) {
          Thread.sleep(IDLE_MS);
        } else {
          socket.send(message);
        }
      }
    } catch (InterruptedException e) {
      Thread.currentThread().interrupt();
    }
    if (lost.get() != null) {
      throw lost.get();
    }
  }
}
