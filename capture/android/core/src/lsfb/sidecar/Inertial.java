package lsfb.sidecar;

import java.util.ArrayDeque;
import java.util.ArrayList;
import java.util.List;

/** At each sample of the gyroscope the specific force, taken linearly between its neighbours. */
public final class Inertial {
  /** Between forces that lie further apart nothing is known, nanoseconds. */
  private static final long WIDEST_GAP_NS = 200_000_000L;

  /** A sample of both. */
  public static final class Sample {
    public final long timeNs;
    public final double[] rate;
    public final double[] force;

    Sample(long timeNs, double[] rate, double[] force) {
      this.timeNs = timeNs;
      this.rate = rate;
      this.force = force;
    }
  }

  private final ArrayDeque<Sample> rates = new ArrayDeque<>();
  private Sample before;

  /** A sample of the gyroscope waits for the next force. */
  public void rate(long timeNs, double[] rate) {
    rates.add(new Sample(timeNs, rate, null));
  }

  /** A force completes the samples before it. */
  public List<Sample> force(long timeNs, double[] force) {
    List<Sample> complete = new ArrayList<>();
    while (!rates.isEmpty() && rates.peek().timeNs <= timeNs) {
      Sample rate = rates.poll();
      boolean isBetween =
          before != null && rate.timeNs >= before.timeNs && timeNs > before.timeNs && timeNs - before.timeNs <= WIDEST_GAP_NS;
      if (isBetween) {
        double share = (double) (rate.timeNs - before.timeNs) / (timeNs - before.timeNs);
        double[] between = new double[3];
        for (int axis = 0; axis < 3; axis++) {
          between[axis] = before.force[axis] + share * (force[axis] - before.force[axis]);
        }
        complete.add(new Sample(rate.timeNs, rate.rate, between));
      }
    }
    before = new Sample(timeNs, null, force);
    return complete;
  }
}
