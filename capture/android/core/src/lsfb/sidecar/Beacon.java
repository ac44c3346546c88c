package lsfb.sidecar;

/** What an iBeacon says, or nothing: company 4C 00, type 02, length 15, UUID, major and minor (big-endian), power at one metre. */
final class Beacon {
  private static final int MANUFACTURER = 0xFF;

  String uuid = "";
  int major;
  int minor;
  int measuredPowerDbm;

  static Beacon of(byte[] advert) {
    Beacon beacon = new Beacon();
    // Elements: length, type, data.
    for (int at = 0; at + 1 < advert.length && advert[at] != 0; at += (advert[at] & 0xFF) + 1) {
      boolean isOne = (advert[at] & 0xFF) == 26 && (advert[at + 1] & 0xFF) == MANUFACTURER && at + 26 < advert.length
          && advert[at + 2] == 0x4C && advert[at + 3] == 0 && advert[at + 4] == 2 && advert[at + 5] == 0x15;
      if (isOne) {
        StringBuilder text = new StringBuilder();
        for (int n = 0; n < 16; n++) {
          text.append(n == 4 || n == 6 || n == 8 || n == 10 ? "-" : "").append(String.format("%02x", advert[at + 6 + n]));
        }
        beacon.uuid = text.toString();
        beacon.major = (advert[at + 22] & 0xFF) << 8 | advert[at + 23] & 0xFF;
        beacon.minor = (advert[at + 24] & 0xFF) << 8 | advert[at + 25] & 0xFF;
        beacon.measuredPowerDbm = advert[at + 26];
      }
    }
    return beacon;
  }
}
