package lsfb.sidecar;

import java.net.URI;

/** What the rig shows as a QR code: {@code lsfb://HOST:PORT?fp=…&tok=…}. */
public final class PairingCode {
  public final String host;
  public final int port;
  /** SHA-256 of the public key of the rig's certificate. */
  public final byte[] fingerprint;
  public final byte[] token;

  public PairingCode(String text) {
    URI uri = URI.create(text);
    host = uri.getHost();
    port = uri.getPort();
    byte[] fp = new byte[0];
    byte[] tok = new byte[0];
    for (String pair : String.valueOf(uri.getQuery()).split("&")) {
      if (pair.startsWith("fp=")) {
        fp = bytesOf(pair.substring(3));
      } else if (pair.startsWith("tok=")) {
        tok = bytesOf(pair.substring(4));
      }
    }
    if (!"lsfb".equals(uri.getScheme()) || host == null || port < 0 || fp.length != 32 || tok.length != 16) {
      throw new IllegalArgumentException("not a pairing code: lsfb://HOST:PORT?fp=64 digits&tok=32 digits");
    }
    fingerprint = fp;
    token = tok;
  }

  static byte[] bytesOf(String hex) {
    byte[] bytes = new byte[hex.length() / 2];
    for (int n = 0; n < bytes.length; n++) {
      bytes[n] = (byte) Integer.parseInt(hex.substring(2 * n, 2 * n + 2), 16);
    }
    return bytes;
  }
}
