//! Constants of protocol `lsfb.sidecar.v1`.

/// WebSocket subprotocol: name and version.
pub const SUBPROTOCOL: &str = "lsfb.sidecar.v1";
/// Path of the stream.
pub const STREAM_PATH: &str = "/v1/stream";
/// Largest envelope, bytes.
pub const MAX_ENVELOPE_BYTES: usize = 4 << 20;
/// Channels of a session at most.
pub const MAX_CHANNELS: usize = 64;
/// Connections at once at most.
pub const MAX_CONNECTIONS: usize = 16;

/// Clock of a device disciplined to UTC: its stamps need no mapping.
pub const CLOCK_UTC: &str = "utc";
