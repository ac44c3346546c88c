//! The rig's folder of what it and its devices know each other by: its certificate, the keys of paired devices, invitations.
//!
//! ```text
//! certificate.der  key.der     made when the folder is first opened, and kept: devices know the rig by it
//! devices/NAME                 SHA-256 of the device's key; who removes the file unpairs the device
//! invitations/SHA-256          of a token that was not used yet: until when it may be, seconds since 1970
//! pushers/NAME                 SHA-256 of the key of an app that pushes, and the units that it is set to
//! sessions/NAME                which recordings hold what the device sent
//! identifiers.key              by which identifiers of others are hashed, where that is asked for
//! ```
//!
//! No secret of a device is in it, only what a secret is recognised by. Only the owner of the folder can read it.

use std::fs::{DirBuilder, File, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use lsfb_drivers::sidecar::credentials::{DeviceKey, Fingerprint, PairingToken, from_hex, to_hex};
use lsfb_drivers::sidecar::sensor_logger::PushUnits;
use lsfb_drivers::sidecar::wire::{Refusal, is_name};
use rcgen::{CertificateParams, KeyPair};
use sha2::{Digest, Sha256};
use subtle::ConstantTimeEq;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer, PrivatePkcs8KeyDer};
use tokio_rustls::rustls::server::ParsedCertificate;
use tokio_rustls::rustls::{ServerConfig, version};

use super::pseudonyms::Pseudonyms;
use crate::Error;

/// How long an invitation holds where nothing else is asked for.
pub const INVITATION: Duration = Duration::from_secs(600);
/// Invitations that wait at most: who asks for more has lost sight of them.
const MAX_INVITATIONS: usize = 64;

/// The folder, open.
#[derive(Clone, Debug)]
pub struct PairingFolder {
    path: PathBuf,
    certificate: Vec<u8>,
    fingerprint: Fingerprint,
}

impl PairingFolder {
    /// Opens the folder; what is missing is made.
    pub fn open(path: &Path) -> Result<Self, Error> {
        for folder in ["", "devices", "invitations", "pushers", "sessions"] {
            let folder = path.join(folder);
            DirBuilder::new()
                .recursive(true)
                .mode(0o700)
                .create(&folder)
                .map_err(|cause| io_error(&folder, cause))?;
        }
        let (certificate_path, key_path) = (path.join("certificate.der"), path.join("key.der"));
        if !certificate_path.exists() {
            let unusable = |e: rcgen::Error| io_error(&certificate_path, io::Error::other(e));
            let key = KeyPair::generate().map_err(unusable)?;
            let params = CertificateParams::new(["lsfb-rig".to_owned()]).map_err(unusable)?;
            let certificate = params.self_signed(&key).map_err(unusable)?;
            // The certificate last: where it is, the key is too.
            replace(&key_path, &key.serialize_der())?;
            replace(&certificate_path, certificate.der())?;
        }
        let certificate =
            std::fs::read(&certificate_path).map_err(|cause| io_error(&certificate_path, cause))?;
        let der = CertificateDer::from(certificate.as_slice());
        let parsed = ParsedCertificate::try_from(&der)
            .map_err(|e| io_error(&certificate_path, io::Error::other(e)))?;
        let key = parsed.subject_public_key_info();
        Ok(Self {
            path: path.to_owned(),
            fingerprint: Fingerprint(Sha256::digest(key.as_ref()).into()),
            certificate,
        })
    }

    /// What identifiers of access points and beacons are hashed by; made when it is first asked for, and kept.
    pub(crate) fn pseudonyms(&self) -> Result<Pseudonyms, Error> {
        let path = self.path.join("identifiers.key");
        if !path.exists() {
            replace(&path, &DeviceKey::random()?.0)?;
        }
        let key = std::fs::read(&path).map_err(|cause| io_error(&path, cause))?;
        let wrong = || io_error(&path, io::Error::other("not a key of 32 bytes"));
        Ok(Pseudonyms::new(key.try_into().map_err(|_| wrong())?))
    }

    /// What devices know the rig by.
    pub fn fingerprint(&self) -> Fingerprint {
        self.fingerprint
    }

    /// Names of the devices that are paired, and of the apps that may push.
    pub fn devices(&self) -> Vec<String> {
        let folders = ["devices", "pushers"].map(|name| std::fs::read_dir(self.path.join(name)));
        let entries = folders.into_iter().flatten().flatten();
        let names = entries.filter_map(|entry| {
            let name = entry.ok()?.file_name().into_string().ok()?;
            (!name.ends_with(UNFINISHED)).then_some(name)
        });
        let mut names: Vec<String> = names.collect();
        names.sort();
        names
    }

    /// Forgets a device: it must be paired again. False: it was not paired.
    pub fn unpair(&self, device: &str) -> Result<bool, Error> {
        if !is_name(device) {
            return Ok(false);
        }
        let mut is_gone = false;
        for path in [self.device(device), self.pusher_path(device)] {
            match std::fs::remove_file(&path) {
                Ok(()) => is_gone = true,
                Err(e) if e.kind() == io::ErrorKind::NotFound => {}
                Err(cause) => return Err(io_error(&path, cause)),
            }
        }
        Ok(is_gone)
    }

    /// Lets an app push under a name, set to these units; one of this name could before, and has another key from now on.
    pub fn invite_pusher(&self, name: &str, units: PushUnits) -> Result<PairingToken, Error> {
        let path = self.pusher_path(name);
        if !is_name(name) || self.device(name).exists() {
            let why =
                "expected 1 to 64 letters, digits, '-' and '_', or the name of a paired phone";
            return Err(io_error(&path, io::Error::other(why)));
        }
        let key = PairingToken::random()?;
        let text = format!("{} {}", to_hex(&Sha256::digest(key.0)), units.key());
        replace(&path, text.as_bytes())?;
        Ok(key)
    }

    /// How the app is set that pushes under a name with this key; `None`: it may not.
    pub(super) fn pusher(&self, name: &str, key: &[u8; 16]) -> Option<PushUnits> {
        let text = std::fs::read_to_string(self.pusher_path(name)).ok()?;
        let (known_by, units) = text.split_once(' ')?;
        let expected: [u8; 32] = from_hex(known_by)?;
        let found: [u8; 32] = Sha256::digest(key).into();
        let is_known: bool = expected.ct_eq(&found).into();
        let mut all = PushUnits::ALL.into_iter();
        all.find(|known| is_known && known.key() == units)
    }

    fn pusher_path(&self, name: &str) -> PathBuf {
        self.path.join("pushers").join(name)
    }

    /// Invites one device, for so long.
    pub fn invite(&self, valid: Duration) -> Result<PairingToken, Error> {
        let folder = self.path.join("invitations");
        self.forget_expired(&folder);
        let waiting = std::fs::read_dir(&folder).map_or(0, Iterator::count);
        if waiting >= MAX_INVITATIONS {
            return Err(io_error(
                &folder,
                io::Error::other(format!("{waiting} invitations are pending; remove some")),
            ));
        }
        let token = PairingToken::random()?;
        let until = unix_secs().saturating_add(valid.as_secs());
        replace(&self.invitation(&token), until.to_string().as_bytes())?;
        Ok(token)
    }

    /// What TLS works with: the key is read here and kept nowhere else.
    pub fn tls(&self) -> Result<Arc<ServerConfig>, Error> {
        let path = self.path.join("key.der");
        let key = std::fs::read(&path).map_err(|cause| io_error(&path, cause))?;
        let key = PrivateKeyDer::Pkcs8(PrivatePkcs8KeyDer::from(key));
        let chain = vec![CertificateDer::from(self.certificate.clone())];
        let provider = Arc::new(ring::default_provider());
        ServerConfig::builder_with_provider(provider)
            .with_protocol_versions(&[&version::TLS13])
            .and_then(|builder| builder.with_no_client_auth().with_single_cert(chain, key))
            .map(Arc::new)
            .map_err(|e| io_error(&path, io::Error::other(e)))
    }

    /// Whether a device has the key that it was paired with.
    pub(super) fn knows(&self, device: &str, key: &DeviceKey) -> bool {
        let Some(expected) = self.key_of(device) else {
            return false;
        };
        let found: [u8; 32] = Sha256::digest(key.0).into();
        expected.ct_eq(&found).into()
    }

    /// Pairs a device by an invitation, which is used up.
    pub(super) fn pair(
        &self,
        device: &str,
        key: &DeviceKey,
        token: &PairingToken,
    ) -> Result<(), Refusal> {
        let invitation = self.invitation(token);
        // Found by what the token gives, so that to guess one costs as much as to guess it whole.
        let until = std::fs::read_to_string(&invitation)
            .ok()
            .and_then(|text| text.trim().parse::<u64>().ok())
            .ok_or(Refusal::WrongToken)?;
        if self.device(device).exists() || self.pusher_path(device).exists() {
            return Err(Refusal::NameTaken);
        }
        // Of several who have it, one removes it.
        std::fs::remove_file(&invitation).map_err(|_| Refusal::WrongToken)?;
        if until < unix_secs() || key.0 == [0; 32] {
            return Err(Refusal::WrongToken);
        }
        let known_by = to_hex(&Sha256::digest(key.0));
        create_new(&self.device(device), known_by.as_bytes()).map_err(|_| Refusal::NameTaken)
    }

    pub(super) fn sessions(&self) -> PathBuf {
        self.path.join("sessions")
    }

    fn key_of(&self, device: &str) -> Option<[u8; 32]> {
        let text = std::fs::read_to_string(self.device(device)).ok()?;
        from_hex(text.trim())
    }

    fn device(&self, name: &str) -> PathBuf {
        self.path.join("devices").join(name)
    }

    fn invitation(&self, token: &PairingToken) -> PathBuf {
        let name = to_hex(&Sha256::digest(token.0));
        self.path.join("invitations").join(name)
    }

    fn forget_expired(&self, folder: &Path) {
        for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
            let until = std::fs::read_to_string(entry.path())
                .ok()
                .and_then(|text| text.trim().parse::<u64>().ok());
            if until.is_none_or(|until| until < unix_secs()) {
                // One that stays is refused by its time all the same.
                let _ = std::fs::remove_file(entry.path());
            }
        }
    }
}

/// Ending of a file that is not whole yet; no device has a dot in its name.
const UNFINISHED: &str = ".part";

/// Writes a file that others see whole or not at all, and that survives a power cut.
pub(super) fn replace(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    let unfinished = unfinished(path);
    let written = write_private(&unfinished, bytes)
        .and_then(|()| std::fs::rename(&unfinished, path))
        .and_then(|()| sync_folder(path));
    written.map_err(|cause| io_error(path, cause))
}

/// As [`replace`], where no file of this name is there.
fn create_new(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let unfinished = unfinished(path);
    write_private(&unfinished, bytes)?;
    let linked = std::fs::hard_link(&unfinished, path);
    std::fs::remove_file(&unfinished)?;
    linked?;
    sync_folder(path)
}

fn unfinished(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(format!("-{:?}{UNFINISHED}", std::thread::current().id()));
    PathBuf::from(name)
}

fn write_private(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = OpenOptions::new()
        .write(true)
        .create(true)
        .truncate(true)
        .mode(0o600)
        .open(path)?;
    file.write_all(bytes)?;
    file.sync_all()
}

fn sync_folder(path: &Path) -> io::Result<()> {
    match path.parent() {
        Some(folder) => File::open(folder)?.sync_all(),
        None => Ok(()),
    }
}

fn io_error(path: &Path, cause: io::Error) -> Error {
    Error::Io {
        path: path.to_owned(),
        cause,
    }
}

fn unix_secs() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.map_or(0, |since| since.as_secs())
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt as _;

    use super::*;

    fn key(byte: u8) -> DeviceKey {
        DeviceKey([byte; 32])
    }

    #[test]
    fn an_invitation_pairs_one_device_once_and_not_for_ever() {
        let folder = tempfile::tempdir().unwrap();
        let pairing = PairingFolder::open(folder.path()).unwrap();
        let token = pairing.invite(INVITATION).unwrap();
        assert!(!pairing.knows("phone", &key(1)));
        assert_eq!(
            pairing.pair("phone", &key(1), &PairingToken([0; 16])),
            Err(Refusal::WrongToken)
        );
        assert_eq!(pairing.pair("phone", &key(1), &token), Ok(()));
        assert!(pairing.knows("phone", &key(1)) && !pairing.knows("phone", &key(2)));
        assert_eq!(
            pairing.pair("other", &key(1), &token),
            Err(Refusal::WrongToken),
            "used"
        );
        let second = pairing.invite(INVITATION).unwrap();
        assert_eq!(
            pairing.pair("phone", &key(2), &second),
            Err(Refusal::NameTaken)
        );
        let old = pairing.invite(Duration::ZERO).unwrap();
        std::thread::sleep(Duration::from_millis(1_100));
        assert_eq!(
            pairing.pair("late", &key(3), &old),
            Err(Refusal::WrongToken)
        );
        assert_eq!(pairing.devices(), ["phone"]);
    }

    #[test]
    fn the_certificate_is_kept_and_no_secret_of_a_device_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("phones");
        let first = PairingFolder::open(&path).unwrap();
        let token = first.invite(INVITATION).unwrap();
        first.pair("phone", &key(7), &token).unwrap();
        let unused = first.invite(INVITATION).unwrap();
        let again = PairingFolder::open(&path).unwrap();
        assert_eq!(first.fingerprint(), again.fingerprint());
        assert!(again.knows("phone", &key(7)));
        again.tls().unwrap();
        for entry in [path.clone(), path.join("devices"), path.join("invitations")] {
            let mode = std::fs::metadata(&entry).unwrap().permissions().mode();
            assert_eq!(mode & 0o077, 0, "{}", entry.display());
            for file in std::fs::read_dir(&entry).unwrap() {
                let file = file.unwrap().path();
                if file.is_dir() {
                    continue;
                }
                let mode = std::fs::metadata(&file).unwrap().permissions().mode();
                assert_eq!(mode & 0o077, 0, "{}", file.display());
                let text = String::from_utf8_lossy(&std::fs::read(&file).unwrap()).into_owned();
                let name = file.display().to_string();
                for secret in [to_hex(&key(7).0), to_hex(&token.0), to_hex(&unused.0)] {
                    assert!(!text.contains(&secret) && !name.contains(&secret), "{name}");
                }
            }
        }
    }
}
