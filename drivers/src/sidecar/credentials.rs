//! What a device and a rig know each other by. Nothing here is ever printed: `Debug` of a secret shows none of it.

use std::fmt;
use std::str::FromStr;

use crate::Error;

/// Scheme of a pairing code.
const SCHEME: &str = "lsfb://";

/// SHA-256 of the public key (SPKI, DER) in the rig's certificate: the app talks to the rig that has it and to no other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fingerprint(pub [u8; 32]);

/// What a device proves with that it was paired, chosen by the device itself at random and kept in its key store.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct DeviceKey(pub [u8; 32]);

/// Invites one device, once.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct PairingToken(pub [u8; 16]);

impl DeviceKey {
    /// A new one, of the operating system's random numbers.
    pub fn random() -> Result<Self, Error> {
        random().map(Self)
    }
}

impl PairingToken {
    /// A new one, of the operating system's random numbers.
    pub fn random() -> Result<Self, Error> {
        random().map(Self)
    }
}

fn random<const N: usize>() -> Result<[u8; N], Error> {
    let mut bytes = [0; N];
    let provider = rustls::crypto::ring::default_provider();
    provider
        .secure_random
        .fill(&mut bytes)
        .map_err(|_| Error::Open {
            device: "random numbers".to_owned(),
            action: "read them from the operating system",
            cause: std::io::ErrorKind::Other.into(),
        })?;
    Ok(bytes)
}

impl fmt::Debug for DeviceKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("DeviceKey(secret)")
    }
}

impl fmt::Debug for PairingToken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("PairingToken(secret)")
    }
}

/// What the rig shows as a QR code and the app reads: where the rig is, who it is, and the invitation.
///
/// Its text is `lsfb://HOST:PORT?fp=FINGERPRINT&tok=TOKEN`, both in lower-case hexadecimal digits.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PairingCode {
    /// Host and port, as in a URL.
    pub address: String,
    /// The rig's certificate.
    pub fingerprint: Fingerprint,
    /// The invitation.
    pub token: PairingToken,
}

impl PairingCode {
    /// The text behind the QR code. A secret until it is used: shown to the person in front of the screen, never logged.
    pub fn to_text(&self) -> String {
        format!(
            "{SCHEME}{}?fp={}&tok={}",
            self.address,
            to_hex(&self.fingerprint.0),
            to_hex(&self.token.0)
        )
    }

    /// A link to the rig's page for browsers. The invitation is in the part that a browser sends to nobody. As secret as the text.
    pub fn to_link(&self) -> String {
        format!("https://{}/#tok={}", self.address, to_hex(&self.token.0))
    }
}

/// Why a text is no pairing code.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum PairingCodeError {
    /// It begins otherwise.
    #[error("a pairing code begins with {SCHEME}")]
    Scheme,
    /// A part is not there, or not as it should be.
    #[error(
        "the {0} of the pairing code is missing or wrong; expected HOST:PORT?fp=64 digits&tok=32 digits"
    )]
    Part(&'static str),
}

impl FromStr for PairingCode {
    type Err = PairingCodeError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let rest = text.strip_prefix(SCHEME).ok_or(PairingCodeError::Scheme)?;
        let (address, query) = rest
            .split_once('?')
            .ok_or(PairingCodeError::Part("fingerprint"))?;
        let is_address = address
            .rsplit_once(':')
            .is_some_and(|(host, port)| !host.is_empty() && port.parse::<u16>().is_ok());
        if !is_address {
            return Err(PairingCodeError::Part("address"));
        }
        let value = |key: &str| {
            query
                .split('&')
                .find_map(|pair| pair.strip_prefix(key)?.strip_prefix('='))
        };
        let fingerprint = value("fp").and_then(from_hex);
        let token = value("tok").and_then(from_hex);
        Ok(Self {
            address: address.to_owned(),
            fingerprint: Fingerprint(fingerprint.ok_or(PairingCodeError::Part("fingerprint"))?),
            token: PairingToken(token.ok_or(PairingCodeError::Part("token"))?),
        })
    }
}

/// Lower-case hexadecimal digits.
pub fn to_hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// As many bytes as are wanted, of hexadecimal digits and nothing else.
pub fn from_hex<const N: usize>(text: &str) -> Option<[u8; N]> {
    if text.len() != 2 * N || !text.bytes().all(|b| b.is_ascii_hexdigit()) {
        return None;
    }
    let mut bytes = [0; N];
    for (byte, at) in bytes.iter_mut().zip((0..).step_by(2)) {
        *byte = u8::from_str_radix(text.get(at..at + 2)?, 16).ok()?;
    }
    Some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairing_codes_are_read_as_they_are_written() {
        let code = PairingCode {
            address: "192.168.1.5:8790".to_owned(),
            fingerprint: Fingerprint([0xAB; 32]),
            token: PairingToken([7; 16]),
        };
        let text = code.to_text();
        assert_eq!(text.parse(), Ok(code.clone()));
        assert_eq!(
            "https://x".parse::<PairingCode>(),
            Err(PairingCodeError::Scheme)
        );
        for (from, to, part) in [
            ("?", "", "fingerprint"),
            (":8790", "", "address"),
            ("8790", "70000", "address"),
            ("fp=ab", "fp=", "fingerprint"),
            ("fp=ab", "fp=+b", "fingerprint"),
            ("tok=", "tok=é", "token"),
            ("&tok", "&t", "token"),
        ] {
            let wrong = text.replacen(from, to, 1);
            assert_eq!(
                wrong.parse::<PairingCode>(),
                Err(PairingCodeError::Part(part)),
                "{wrong}"
            );
        }
        let shown = format!("{code:?} {:?}", DeviceKey([9; 32]));
        assert!(!shown.contains("[7") && !shown.contains("[9"), "{shown}");
    }
}
