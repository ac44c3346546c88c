package lsfb.recorder;

import java.io.IOException;
import java.util.function.Consumer;
import lsfb.sidecar.Channel;
import lsfb.sidecar.FrameTimes;
import lsfb.sidecar.Records;
import lsfb.sidecar.Session;

/** The channels of a walk. What cannot be kept is told: a full storage ends the walk, and nothing is left out in silence. */
final class Outlet {
  static final int IMU = 1;
  static final int MAGNETIC = 2;
  static final int WIFI = 3;
  static final int WIFI_SCAN = 4;
  static final int BLE = 5;
  static final int IMAGE = 6;
  static final int FRAME_META = 7;
  /** One topic has one clock: images whose clock is unknown are not on the topic of those whose clock is known. */
  static final int IMAGE_OF_UNKNOWN_CLOCK = 8;

  static final int FRAME_META_OF_UNKNOWN_CLOCK = 9;

  private final Session session;
  private final Consumer<String> screen;

  Outlet(Session session, String device, Consumer<String> screen) {
    this.session = session;
    this.screen = screen;
    String[][] channels = {
      {"imu", "sensor_msgs/msg/Imu", Records.BOOT_CLOCK},
      {"mag", "sensor_msgs/msg/MagneticField", Records.BOOT_CLOCK},
      {"wifi", "lsfb_msgs/msg/WifiReading", Records.BOOT_CLOCK},
      {"wifi_scan", "lsfb_msgs/msg/WifiScan", Records.BOOT_CLOCK},
      {"ble", "lsfb_msgs/msg/BleAdvert", Records.BOOT_CLOCK},
      {"cam0/image", "sensor_msgs/msg/Image", Records.BOOT_CLOCK},
      {"cam0/frame_meta", "lsfb_msgs/msg/FrameMeta", Records.BOOT_CLOCK},
      {"cam0_unsynchronized/image", "sensor_msgs/msg/Image", FrameTimes.UNKNOWN_CLOCK},
      {"cam0_unsynchronized/frame_meta", "lsfb_msgs/msg/FrameMeta", FrameTimes.UNKNOWN_CLOCK},
    };
    for (int n = 0; n < channels.length; n++) {
      String[] channel = channels[n];
      String topic = "/sidecar/" + device + "/" + channel[0];
      session.describe(new Channel(n + 1, topic, channel[1], Records.SCHEMAS.get(channel[1]), channel[2], ""));
    }
  }

  void put(int channel, long timeNs, byte[] message) {
    try {
      session.measured(channel, timeNs, message);
    } catch (IOException e) {
      problem("the phone's storage: " + e.getMessage());
    }
  }

  void problem(String words) {
    screen.accept(words);
  }

  void show(String words) {
    if (!words.isEmpty()) {
      screen.accept(words);
    }
  }
}
