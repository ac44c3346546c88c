//! Sensor drivers: bytes to packets to samples, and back.
