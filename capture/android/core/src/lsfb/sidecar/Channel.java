package lsfb.sidecar;

import java.nio.charset.StandardCharsets;

/** A channel as ADVERTISE describes it: what an MCAP file keeps as schema and channel. */
public final class Channel {
  public final int number;
  private final String topic;
  private final String schemaName;
  private final String schema;
  private final String clockId;
  private final String metadataJson;

  public Channel(
      int number, String topic, String schemaName, String schema, String clockId, String metadataJson) {
    this.number = number;
    this.topic = topic;
    this.schemaName = schemaName;
    this.schema = schema;
    this.clockId = clockId;
    this.metadataJson = metadataJson;
  }

  byte[] emit() {
    return new Protobuf()
        .number(1, number)
        .text(2, topic)
        .text(3, "cdr")
        .text(4, schemaName)
        .bytes(5, schema.getBytes(StandardCharsets.UTF_8))
        .text(6, clockId)
        .text(7, metadataJson)
        .done();
  }
}
