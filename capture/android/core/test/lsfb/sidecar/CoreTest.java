package lsfb.sidecar;

import java.io.File;
import java.io.RandomAccessFile;
import java.nio.file.Files;
import java.nio.file.Path;
import java.util.Arrays;
import java.util.List;
import java.util.Map;

/** What can be tried without a rig. Arguments: the document with the test vectors, an empty folder. */
public final class CoreTest {
  public static void main(String[] arguments) throws Exception {
    vectors(Path.of(arguments[0]));
    spoolSurvivesAPhoneThatWasKilled(new File(arguments[1], "spool"));
    oldResultsAreNoScan();
    framesAreStampedInTheMiddle();
    forcesAreTakenBetweenTheirNeighbours();
    System.out.println("core: all passed");
  }

  private static void check(boolean holds, String what) {
    if (!holds) {
      throw new AssertionError(what);
    }
  }

  /** Envelopes that Python's protobuf wrote are read and written byte for byte. */
  private static void vectors(Path document) throws Exception {
    int found = 0;
    for (String line : Files.readAllLines(document)) {
      if (line.startsWith("VECTOR ")) {
        byte[] bytes = PairingCode.bytesOf(line.split(" ")[2]);
        Envelope read = Envelope.parse(bytes);
        check(Arrays.equals(read.emit(), bytes), line);
        if (line.startsWith("VECTOR DATA")) {
          check(read.channel == 300 && read.seq == (1L << 40) + 5, line);
          check(read.deviceTimeNs == 1772359200123456789L, line);
          check(Arrays.equals(read.payload, new byte[] {1, 2, 3, (byte) 0xFA}), line);
        }
        found++;
      }
    }
    check(found == 8, found + " vectors");
  }

  private static void spoolSurvivesAPhoneThatWasKilled(File folder) throws Exception {
    try (Spool spool = new Spool(folder)) {
      for (long seq = 1; seq <= 100; seq++) {
        spool.put(new Envelope(Envelope.DATA, 1, seq, seq, new byte[] {(byte) seq}));
      }
      spool.acknowledge(40);
    }
    // In the middle of a record.
    File file = new File(folder, "1.spool");
    try (RandomAccessFile cut = new RandomAccessFile(file, "rw")) {
      cut.setLength(cut.length() - 3);
    }
    try (Spool spool = new Spool(folder)) {
      check(spool.lastSeq() == 99 && spool.firstUnacknowledged() == 41, "what is left: " + spool.lastSeq());
      check(spool.read(40) == null && spool.read(100) == null, "what is not");
      check(Envelope.parse(spool.read(99)).payload[0] == 99, "the last");
      check(Envelope.parse(spool.read(41)).payload[0] == 41, "the first, after the last");
      spool.put(new Envelope(Envelope.DATA, 1, 100, 0, new byte[] {7}));
      check(Envelope.parse(spool.read(100)).payload[0] == 7, "one more");
      spool.acknowledge(100);
    }
    check(new Spool(folder).lastSeq() == 100, "an empty spool does not begin anew");
  }

  private static void oldResultsAreNoScan() {
    ScanThrottle throttle = new ScanThrottle();
    for (int n = 0; n < 4; n++) {
      check(throttle.mayStart(n), "four are allowed");
      throttle.started(n, true);
    }
    check(!throttle.mayStart(119_000_000_000L) && throttle.mayStart(120_000_000_001L), "in two minutes");
    check(throttle.areNew(Map.of("a", 5L, "b", 9L)) && throttle.areNew(Map.of("a", 5L, "c", 10L)), "new");
    check(throttle.sentence().isEmpty(), throttle.sentence());
    check(!throttle.areNew(Map.of("a", 5L, "c", 10L)), "the same once more");
    throttle.started(7, false);
    check(throttle.sentence().contains("1 refused, 1 times old"), throttle.sentence());
  }

  private static void framesAreStampedInTheMiddle() {
    FrameTimes frame = new FrameTimes(FrameTimes.SOURCE_REALTIME, 1_000, 200, 60);
    check(frame.timeNs == 1_130 && frame.clockId.equals(Records.BOOT_CLOCK), "the middle");
    check(new FrameTimes(0, 1, 0, 0).clockId.equals(FrameTimes.UNKNOWN_CLOCK), "a source that is not known is not believed");
    byte[] grey = Records.image(0, "", 2, 2, 3, new byte[] {1, 2, 0, 3, 4, 0});
    check(Arrays.equals(Arrays.copyOfRange(grey, grey.length - 4, grey.length), new byte[] {1, 2, 3, 4}), "rows");
    byte[] advert = PairingCode.bytesOf("0201061aff4c0002159195b3ada9d0450085ff9fb0f65a520101020304c8");
    Beacon beacon = Beacon.of(advert);
    check(beacon.uuid.equals("9195b3ad-a9d0-4500-85ff-9fb0f65a5201"), beacon.uuid);
    check(beacon.major == 258 && beacon.minor == 772 && beacon.measuredPowerDbm == -56, "its numbers");
    check(Beacon.of(Arrays.copyOf(advert, 20)).uuid.isEmpty(), "one that is cut off");
  }

  private static void forcesAreTakenBetweenTheirNeighbours() {
    Inertial inertial = new Inertial();
    inertial.rate(5, new double[3]);
    check(inertial.force(10, new double[] {1, 0, 0}).isEmpty(), "nothing is before it");
    inertial.rate(12, new double[] {0, 0, 3});
    List<Inertial.Sample> complete = inertial.force(20, new double[] {2, 0, 0});
    check(complete.size() == 1 && Math.abs(complete.get(0).force[0] - 1.2) < 1e-12, "a fifth of the way");
  }
}
