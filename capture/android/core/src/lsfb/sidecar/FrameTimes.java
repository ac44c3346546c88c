package lsfb.sidecar;

/** What Camera2 says of a frame, and the record that becomes of it: pure, so that it can be tried without a camera. */
public final class FrameTimes {
  /** CameraMetadata.SENSOR_INFO_TIMESTAMP_SOURCE_REALTIME: frames are stamped by the clock of the inertial sensors. */
  public static final int SOURCE_REALTIME = 1;

  /** Clock of frames whose source is unknown: not to be taken for that of the inertial sensors, though it often is. */
  public static final String UNKNOWN_CLOCK = "android.cameraUnknown";

  /** Middle of the exposure of the middle row, nanoseconds. */
  public final long timeNs;
  public final String clockId;
  private final long sensorTimestampNs;
  private final long exposureNs;
  private final long skewNs;

  /**
   * SENSOR_TIMESTAMP is the start of the exposure of the first row, SENSOR_EXPOSURE_TIME is each row's, and SENSOR_ROLLING_SHUTTER_SKEW from
   * the first row's start to the last's.
   */
  public FrameTimes(int timestampSource, long sensorTimestampNs, long exposureNs, long skewNs) {
    this.sensorTimestampNs = sensorTimestampNs;
    this.exposureNs = Math.max(0, exposureNs);
    this.skewNs = Math.max(0, skewNs);
    timeNs = sensorTimestampNs + this.exposureNs / 2 + this.skewNs / 2;
    clockId = timestampSource == SOURCE_REALTIME ? Records.BOOT_CLOCK : UNKNOWN_CLOCK;
  }

  /** {@code lsfb_msgs/msg/FrameMeta}; its trailer is text: the skew, the sensitivity and the focal length as Camera2 tells them. */
  public byte[] record(String frame, int number, int iso, float focalLengthMm) {
    String trailer =
        "rolling_shutter_skew_ns=" + skewNs + "\nsensitivity_iso=" + iso + "\nfocal_length_mm=" + focalLengthMm + "\n";
    int exposure = (int) Math.min(exposureNs, 0xFFFFFFFFL);
    return new Cdr(256)
        .header(timeNs, frame)
        .u32(number)
        .u64(sensorTimestampNs)
        .u32(exposure)
        .bytes(trailer.getBytes(java.nio.charset.StandardCharsets.UTF_8))
        .done();
  }
}
