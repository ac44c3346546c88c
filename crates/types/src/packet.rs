use crate::Timestamp;

/// The bytes a device sent, with the time at which the host received them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Packet {
    /// Host receive time: the kernel's stamp where there is one.
    pub arrival: Timestamp,
    /// The payload, exactly as received.
    pub bytes: Vec<u8>,
}
