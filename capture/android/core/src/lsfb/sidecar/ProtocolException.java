package lsfb.sidecar;

import java.io.IOException;

/** The other side said what it may not; the connection ends, and the session goes on with the next one. */
public final class ProtocolException extends IOException {
  private static final long serialVersionUID = 1;

  public ProtocolException(String problem) {
    super(problem);
  }
}
