//! A simulated world with devices that speak the real wire formats.
