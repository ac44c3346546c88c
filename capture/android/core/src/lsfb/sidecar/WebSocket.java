package lsfb.sidecar;

import java.io.Closeable;
import java.io.DataInputStream;
import java.io.EOFException;
import java.io.IOException;
import java.io.OutputStream;
import java.net.InetSocketAddress;
import java.nio.ByteBuffer;
import java.nio.charset.StandardCharsets;
import java.security.GeneralSecurityException;
import java.security.MessageDigest;
import java.security.SecureRandom;
import java.security.cert.CertificateException;
import java.security.cert.X509Certificate;
import java.util.Base64;
import javax.net.ssl.SSLContext;
import javax.net.ssl.SSLSocket;
import javax.net.ssl.TrustManager;
import javax.net.ssl.X509TrustManager;

/** A WebSocket (RFC 6455) to the rig over TLS 1.3, which trusts the one public key of the pairing code and nothing else. */
public final class WebSocket implements Closeable {
  private static final int TIMEOUT_MS = 10_000;
  private static final int BINARY = 2;
  private static final int CLOSE = 8;
  private static final int PING = 9;
  private static final int PONG = 10;

  private final SSLSocket socket;
  private final DataInputStream in;
  private final OutputStream out;
  private final SecureRandom random = new SecureRandom();

  public WebSocket(PairingCode rig) throws IOException {
    try {
      SSLContext tls = SSLContext.getInstance("TLS");
      tls.init(null, new TrustManager[] {new Pinned(rig.fingerprint)}, random);
      socket = (SSLSocket) tls.getSocketFactory().createSocket();
    } catch (GeneralSecurityException e) {
      throw new IOException(e);
    }
    socket.connect(new InetSocketAddress(rig.host, rig.port), TIMEOUT_MS);
    socket.setSoTimeout(TIMEOUT_MS);
    socket.setTcpNoDelay(true);
    socket.setEnabledProtocols(new String[] {"TLSv1.3"});
    socket.startHandshake();
    in = new DataInputStream(new java.io.BufferedInputStream(socket.getInputStream()));
    out = socket.getOutputStream();
    byte[] nonce = new byte[16];
    random.nextBytes(nonce);
    String head =
        "GET /v1/stream HTTP/1.1\r\nHost: " + rig.host + ":" + rig.port + "\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            + "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Protocol: lsfb.sidecar.v1\r\nSec-WebSocket-Key: "
            + Base64.getEncoder().encodeToString(nonce) + "\r\n\r\n";
    out.write(head.getBytes(StandardCharsets.US_ASCII));
    String status = line();
    if (!status.startsWith("HTTP/1.1 101")) {
      throw new IOException("the rig answered " + status);
    }
    while (!line().isEmpty()) {
      // The key was pinned: which of its headers it sends does not matter.
    }
  }

  /** Sends one message. Every frame of a client is masked. */
  public void send(byte[] message) throws IOException {
    frame(BINARY, message);
  }

  /** The next message; pings are answered meanwhile. */
  public byte[] receive() throws IOException {
    ByteBuffer whole = ByteBuffer.allocate(0);
    while (true) {
      int first = in.readUnsignedByte();
      long length = in.readUnsignedByte() & 0x7F;
      if (length == 126) {
        length = in.readUnsignedShort();
      } else if (length == 127) {
        length = in.readLong();
      }
      if (length < 0 || length + whole.capacity() > Envelope.MAX_BYTES) {
        throw new ProtocolException("a message is too long");
      }
      byte[] payload = new byte[(int) length];
      in.readFully(payload);
      switch (first & 0x0F) {
        case PING:
          frame(PONG, payload);
          break;
        case PONG:
          break;
        case CLOSE:
          throw new EOFException("the rig closed the connection");
        default:
          whole = ByteBuffer.allocate(whole.capacity() + payload.length).put(whole.array()).put(payload);
          if ((first & 0x80) != 0) {
            return whole.array();
          }
      }
    }
  }

  @Override
  public void close() throws IOException {
    socket.close();
  }

  private synchronized void frame(int opcode, byte[] payload) throws IOException {
    ByteBuffer frame = ByteBuffer.allocate(payload.length + 14);
    frame.put((byte) (0x80 | opcode));
    if (payload.length < 126) {
      frame.put((byte) (0x80 | payload.length));
    } else if (payload.length < 1 << 16) {
      frame.put((byte) (0x80 | 126)).putShort((short) payload.length);
    } else {
      frame.put((byte) (0x80 | 127)).putLong(payload.length);
    }
    byte[] mask = new byte[4];
    random.nextBytes(mask);
    frame.put(mask);
    for (int n = 0; n < payload.length; n++) {
      frame.put((byte) (payload[n] ^ mask[n & 3]));
    }
    out.write(frame.array(), 0, frame.position());
    out.flush();
  }

  private String line() throws IOException {
    StringBuilder line = new StringBuilder();
    for (int c = in.readUnsignedByte(); c != '\n'; c = in.readUnsignedByte()) {
      if (c != '\r') {
        line.append((char) c);
      }
      if (line.length() > 8192) {
        throw new ProtocolException("a header is too long");
      }
    }
    return line.toString();
  }

  private static final class Pinned implements X509TrustManager {
    private final byte[] fingerprint;

    Pinned(byte[] fingerprint) {
      this.fingerprint = fingerprint;
    }

    @Override
    public void checkClientTrusted(X509Certificate[] chain, String type) throws CertificateException {
      throw new CertificateException("a rig is not a client");
    }

    @Override
    public void checkServerTrusted(X509Certificate[] chain, String type) throws CertificateException {
      try {
        byte[] found = MessageDigest.getInstance("SHA-256").digest(chain[0].getPublicKey().getEncoded());
        if (!MessageDigest.isEqual(found, fingerprint)) {
          throw new CertificateException("this rig does not match the pairing code");
        }
      } catch (GeneralSecurityException e) {
        throw new CertificateException(e);
      }
    }

    @Override
    public X509Certificate[] getAcceptedIssuers() {
      return new X509Certificate[0];
    }
  }
}
