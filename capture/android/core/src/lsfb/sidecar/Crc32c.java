package lsfb.sidecar;

/** CRC-32C (Castagnoli): {@code java.util.zip.CRC32C} is on Android 14 and later only. */
final class Crc32c {
  private static final int POLYNOMIAL = 0x82F63B78;
  private static final int[] TABLE = new int[256];

  static {
    for (int n = 0; n < 256; n++) {
      int value = n;
      for (int bit = 0; bit < 8; bit++) {
        value = (value & 1) != 0 ? (value >>> 1) ^ POLYNOMIAL : value >>> 1;
      }
      TABLE[n] = value;
    }
  }

  private Crc32c() {}

  static int of(byte[] bytes) {
    int crc = ~0;
    for (byte b : bytes) {
      crc = TABLE[(crc ^ b) & 0xFF] ^ (crc >>> 8);
    }
    return ~crc;
  }
}
