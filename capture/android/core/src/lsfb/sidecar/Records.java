package lsfb.sidecar;

import java.util.Map;

/** What a phone measures, as the messages that recordings hold. Times are of {@code SystemClock.elapsedRealtimeNanos}. */
public final class Records {
  /** The clock of SensorEvent.timestamp, ScanResult.timestamp and, where the camera says REALTIME, of its frames. */
  public static final String BOOT_CLOCK = "android.elapsedRealtime";

  private static final String RULE =
      "================================================================================\n";
  private static final String HEADER =
      RULE + "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
          + RULE + "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n";
  private static final String VECTOR3 = RULE + "MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n";

  public static final Map<String, String> SCHEMAS =
      Map.of(
          "sensor_msgs/msg/Imu",
          "std_msgs/Header header\ngeometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n"
              + "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n"
              + "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance\n"
              + HEADER + VECTOR3
              + RULE + "MSG: geometry_msgs/Quaternion\nfloat64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n",
          "sensor_msgs/msg/MagneticField",
          "std_msgs/Header header\ngeometry_msgs/Vector3 magnetic_field\nfloat64[9] magnetic_field_covariance\n"
              + VECTOR3 + HEADER,
          "sensor_msgs/msg/Image",
          "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\n"
              + "uint8[] data\n" + HEADER,
          "lsfb_msgs/msg/WifiReading",
          "std_msgs/Header header\nuint32 scan\nstring bssid\nstring ssid\nuint32 frequency_mhz\nint16 rssi_dbm\n" + HEADER,
          "lsfb_msgs/msg/WifiScan",
          "std_msgs/Header header\nuint32 scan\nbuiltin_interfaces/Time started\nbuiltin_interfaces/Time ended\n"
              + "uint32 readings\n" + HEADER,
          "lsfb_msgs/msg/BleAdvert",
          "std_msgs/Header header\nstring address\nstring uuid\nuint16 major\nuint16 minor\nint16 measured_power_dbm\n"
              + "int16 rssi_dbm\nuint8[] data\n" + HEADER,
          "lsfb_msgs/msg/FrameMeta",
          "std_msgs/Header header\nuint32 frame_id\nuint64 device_ticks\nuint32 exposure_ns\nuint8[] trailer\n" + HEADER);

  private Records() {}

  /** rad/s, and m/s² with gravity upwards at rest, in Android's axes: TYPE_GYROSCOPE_UNCALIBRATED, TYPE_ACCELEROMETER_UNCALIBRATED. */
  public static byte[] imu(long timeNs, String frame, double[] rate, double[] force) {
    Cdr out = new Cdr(320).header(timeNs, frame).f64(0, 0, 0, 1);
    // No orientation is told.
    out.f64(-1, 0, 0, 0, 0, 0, 0, 0, 0);
    out.f64(rate).f64(new double[9]);
    return out.f64(force).f64(new double[9]).done();
  }

  /** Microtesla of TYPE_MAGNETIC_FIELD_UNCALIBRATED: without the system's correction, which jumps when it learns. */
  public static byte[] magnetic(long timeNs, String frame, double[] microtesla) {
    Cdr out = new Cdr(128).header(timeNs, frame);
    for (double axis : microtesla) {
      out.f64(axis * 1e-6);
    }
    return out.f64(new double[9]).done();
  }

  /** The luminance plane of a YUV_420_888 image, whose rows may be longer than the image is wide. */
  public static byte[] image(long timeNs, String frame, int width, int height, int rowBytes, byte[] luminance) {
    byte[] pixels = new byte[width * height];
    for (int row = 0; row < height; row++) {
      System.arraycopy(luminance, row * rowBytes, pixels, row * width, width);
    }
    Cdr out = new Cdr(pixels.length + 64).header(timeNs, frame).u32(height).u32(width).text("mono8");
    return out.u8(0).u32(width).bytes(pixels).done();
  }

  public static byte[] wifiReading(
      long heardNs, String frame, int scan, String bssid, String ssid, int frequencyMhz, int levelDbm) {
    Cdr out = new Cdr(128).header(heardNs, frame).u32(scan).text(bssid).text(ssid);
    return out.u32(frequencyMhz).u16(levelDbm).done();
  }

  /** Times of the phone's clock; 0 where the scan was somebody else's. */
  public static byte[] wifiScan(long handedOutNs, String frame, int scan, long startedNs, long endedNs, int readings) {
    Cdr out = new Cdr(96).header(handedOutNs, frame).u32(scan);
    for (long time : new long[] {startedNs, endedNs}) {
      out.u32((int) Math.floorDiv(time, 1_000_000_000L)).u32((int) Math.floorMod(time, 1_000_000_000L));
    }
    return out.u32(readings).done();
  }

  /** An advertisement as sent; an iBeacon's numbers beside it. */
  public static byte[] ble(long heardNs, String frame, String address, int rssiDbm, byte[] advert) {
    Beacon beacon = Beacon.of(advert);
    Cdr out = new Cdr(128 + advert.length).header(heardNs, frame).text(address).text(beacon.uuid);
    return out.u16(beacon.major).u16(beacon.minor).u16(beacon.measuredPowerDbm).u16(rssiDbm).bytes(advert).done();
  }
}
