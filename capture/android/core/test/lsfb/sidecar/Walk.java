package lsfb.sidecar;

import java.io.File;
import java.util.Arrays;

/**
 * A phone on a JVM that walks past a real rig: pairing code, name, spool folder, number of messages, pause in ms. Started again with the same
 * folder it goes on where it was killed.
 */
public final class Walk {
  public static void main(String[] arguments) throws Exception {
    PairingCode rig = new PairingCode(arguments[0]);
    String device = arguments[1];
    int messages = Integer.parseInt(arguments[3]);
    int pauseMs = Integer.parseInt(arguments[4]);
    // A fixed key: a phone that was killed comes back with that of its key store.
    byte[] key = new byte[32];
    Arrays.fill(key, (byte) 7);
    Spool spool = new Spool(new File(arguments[2]));
    Session session = new Session("walk-1", device, key, rig.token, spool, Records.BOOT_CLOCK);
    String imu = "sensor_msgs/msg/Imu";
    session.describe(
        new Channel(1, "/sidecar/" + device + "/imu", imu, Records.SCHEMAS.get(imu), Records.BOOT_CLOCK, ""));
    Phone phone = new Phone(session, spool, rig, System::nanoTime);
    Thread sending = new Thread(phone, "sidecar-send");
    sending.start();
    for (long n = spool.lastSeq(); n < messages; n++) {
      long nowNs = System.nanoTime();
      session.measured(1, nowNs, Records.imu(nowNs, device, new double[] {n, 0, 0}, new double[] {0, 0, 9.81}));
      Thread.sleep(pauseMs);
    }
    phone.end();
    sending.join();
    if (phone.refusal() != null) {
      throw phone.refusal();
    }
    System.out.println("stored " + spool.lastSeq());
  }
}
