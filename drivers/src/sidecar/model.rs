//! Constants of protocol `lsfb.sidecar.v1`; `docs/sidecar.md` is its specification.

/// WebSocket subprotocol: name and version.
pub const SUBPROTOCOL: &str = "lsfb.sidecar.v1";
/// Path of the stream.
pub const STREAM_PATH: &str = "/v1/stream";
/// Largest envelope, bytes.
pub const MAX_ENVELOPE_BYTES: usize = 4 << 20;
/// Channels of a session at most.
pub const MAX_CHANNELS: usize = 64;
/// Devices at once at most.
pub const MAX_DEVICES: usize = 16;
/// Bytes of DATA envelopes that an app may have under way from the beginning on. One envelope always fits.
pub const INITIAL_CREDIT_BYTES: u64 = MAX_ENVELOPE_BYTES as u64;

/// Clock of a device disciplined to UTC: its stamps need no mapping.
pub const CLOCK_UTC: &str = "utc";
