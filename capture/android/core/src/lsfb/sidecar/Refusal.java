package lsfb.sidecar;

import java.io.IOException;

/** The rig ended the connection and said why (docs/sidecar.md, "Refusals"). */
public final class Refusal extends IOException {
  private static final long serialVersionUID = 1;

  public final int code;

  Refusal(int code, String text) {
    super(code + ": " + text);
    this.code = code;
  }

  /** Whether to connect again may help: not without a pairing, with a wrong code, a name that is taken, or a topic that is refused. */
  public boolean mayPass() {
    return code != 1 && code != 2 && code != 3 && code != 7;
  }
}
