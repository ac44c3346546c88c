package lsfb.sidecar;

import java.util.ArrayDeque;
import java.util.Map;

/**
 * Whether the system holds Wi-Fi scans back. Android lets an app in front start four scans in two minutes; beyond that it refuses, or
 * hands out the results of an earlier scan once more, which only their times tell.
 */
public final class ScanThrottle {
  private static final int ALLOWED = 4;
  private static final long WINDOW_NS = 120_000_000_000L;

  private final ArrayDeque<Long> started = new ArrayDeque<>();
  private long newestNs = Long.MIN_VALUE;
  private int refused;
  private int old;

  /** Whether a scan may be started now without being refused. */
  public boolean mayStart(long nowNs) {
    while (!started.isEmpty() && nowNs - started.peek() >= WINDOW_NS) {
      started.poll();
    }
    return started.size() < ALLOWED;
  }

  /** WifiManager.startScan was called, and answered. */
  public void started(long nowNs, boolean wasAccepted) {
    if (wasAccepted) {
      started.add(nowNs);
    } else {
      refused++;
    }
  }

  /**
   * Results were handed out: times at which each network was heard, by its address. True: they are of now; false: nothing in them is newer
   * than what was handed out before, and they are no scan.
   */
  public boolean areNew(Map<String, Long> heardNs) {
    long newest = newestNs;
    for (long heard : heardNs.values()) {
      newest = Math.max(newest, heard);
    }
    boolean areNew = newest > newestNs;
    newestNs = newest;
    if (!areNew) {
      old++;
    }
    return areNew;
  }

  /** For the screen; empty where nothing is held back. */
  public String sentence() {
    if (refused == 0 && old == 0) {
      return "";
    }
    return "Wi-Fi scans are held back by the system: " + refused + " refused, " + old
        + " times old results. Switch off \"Wi-Fi scan throttling\" in the developer options.";
  }
}
