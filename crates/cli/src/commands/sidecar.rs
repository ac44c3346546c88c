//! `lsfb sidecar`: phones that are paired with this rig, and a phone to try a rig with.

use std::collections::BTreeMap;
use std::net::{IpAddr, SocketAddr, ToSocketAddrs as _, UdpSocket};
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context as _, bail};
use lsfb_capture::{DevicesConfig, PairingFolder, SidecarConfig};
use lsfb_drivers::sidecar::ClientConfig;
use lsfb_drivers::sidecar::credentials::{PairingCode, to_hex};
use lsfb_drivers::sidecar::sensor_logger::PushUnits;
use lsfb_sim::{Pace, Playback, PlaybackEndpoints, Turns};

use crate::bad_argument::BadArgument;
use crate::context::Context;
use crate::one_of::one_of;
use crate::outcome::Outcome;
use crate::qr_code;

/// An address to ask the way to: nothing is sent there (RFC 5737).
const ELSEWHERE: (&str, u16) = ("192.0.2.1", 9);

/// Pair phones and glasses with this rig, extract their walks, or play a recorded phone to a rig.
///
/// A phone is paired once, with a code that is valid for one phone and a few minutes; afterwards it
/// connects by itself. docs/sidecar.md describes the protocol for apps.
///
/// Examples:
///   lsfb sidecar pair --devices devices.toml       # show the code; `lsfb scan` may run meanwhile or later
///   lsfb sidecar list --devices devices.toml
///   lsfb sidecar unpair pixel8 --devices devices.toml
///   lsfb sidecar walks scan.mcap --out walks       # each phone becomes a file of its own
///   lsfb sidecar play walk.mcap --code 'lsfb://192.168.8.1:8790?fp=4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f&tok=a7a7a7a7a7a7a7a7a7a7a7a7a7a7a7a7' --fault-seed 7
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    #[command(subcommand)]
    action: Action,
}

#[derive(clap::Subcommand)]
enum Action {
    Pair(Pair),
    List(List),
    Unpair(Unpair),
    Play(Play),
    Walks(super::sidecar_walks::Arguments),
}

/// Show a code that pairs one phone.
///
/// With --browser: a link to the rig's own page, which records through the phone's browser. The browser
/// will warn about the rig's self-signed certificate; continue anyway.
///
/// With --push: the address for HTTP push of the app Sensor Logger, valid until the name is unpaired.
/// Requires `[sidecar] push_listen`; pushed data is not encrypted.
///
/// Examples:
///   lsfb sidecar pair --devices devices.toml
///   lsfb sidecar pair --devices devices.toml --browser
///   lsfb sidecar pair --devices devices.toml --address 192.168.8.1 --valid-secs 1800
///   lsfb sidecar pair --devices devices.toml --push ada           # Sensor Logger's address for HTTP push
///   lsfb sidecar pair --devices devices.toml --push bob --units ios
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
struct Pair {
    /// List of devices with a section `[sidecar]`.
    #[arg(long, value_name = "TOML")]
    devices: PathBuf,
    /// Address of this machine in the phone's network; by default that of the default route.
    #[arg(long, value_name = "IP")]
    address: Option<IpAddr>,
    /// Show a link for a browser, instead of a code for an app.
    #[arg(long)]
    browser: bool,
    /// Show the address for Sensor Logger's HTTP push, and name the phone NAME.
    #[arg(long, value_name = "NAME", conflicts_with = "browser")]
    push: Option<String>,
    /// Units set in Sensor Logger: standard is Android, or "Standardise Units & Frames" on; ios is an
    /// iPhone with that off.
    #[arg(long, requires = "push", default_value = PushUnits::Standard.key(), value_parser = one_of(&PushUnits::ALL, PushUnits::key))]
    units: PushUnits,
    /// How long the code is valid.
    #[arg(long, value_name = "SECS", conflicts_with = "push", default_value_t = 600, value_parser = clap::value_parser!(u32).range(60..=86_400))]
    valid_secs: u32,
}

/// List the paired phones.
///
/// Examples:
///   lsfb sidecar list --devices devices.toml
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
struct List {
    /// List of devices with a section `[sidecar]`.
    #[arg(long, value_name = "TOML")]
    devices: PathBuf,
}

/// Unpair a phone: it must be paired again before it can send.
///
/// Examples:
///   lsfb sidecar unpair pixel8 --devices devices.toml
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
struct Unpair {
    /// Name of the phone.
    name: String,
    /// List of devices with a section `[sidecar]`.
    #[arg(long, value_name = "TOML")]
    devices: PathBuf,
}

/// Play the phones of a recording to a rig, over the protocol that apps use.
///
/// Examples:
///   lsfb sidecar play walk.mcap --code 'lsfb://192.168.8.1:8790?fp=4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f&tok=a7a7a7a7a7a7a7a7a7a7a7a7a7a7a7a7'
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
struct Play {
    /// Recording that contains a phone or glasses.
    #[arg(value_name = "MCAP")]
    recording: PathBuf,
    /// The rig's pairing code.
    #[arg(long, value_name = "CODE", value_parser = pairing_code)]
    code: PairingCode,
    /// Phone of the recording to play; needed if there are several.
    #[arg(long, value_name = "NAME")]
    device: Option<String>,
    /// Name of the session.
    #[arg(long, value_name = "NAME", default_value = "played")]
    session: String,
    /// Playback speed: recorded seconds per second.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = super::mock::speed)]
    speed: f64,
    /// Inject random faults with this seed: cut connections, damaged and repeated messages, pauses.
    #[arg(long, value_name = "N", value_parser = super::seed)]
    fault_seed: Option<u64>,
    /// How long to try to reconnect after losing the rig.
    #[arg(long, value_name = "SECS", default_value_t = 120)]
    reconnect_secs: u32,
}

fn pairing_code(text: &str) -> Result<PairingCode, String> {
    text.parse()
        .map_err(|e: lsfb_drivers::sidecar::credentials::PairingCodeError| e.to_string())
}

/// Does one of these.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    match &arguments.action {
        Action::Pair(pair) => pair.run(context),
        Action::List(list) => {
            let (_, folder) = open(&list.devices)?;
            let names = folder.devices();
            context.print(&serde_json::json!({ "devices": names }), || {
                match names.len() {
                    0 => "no phone is paired".to_owned(),
                    _ => names.join("\n"),
                }
            })?;
            Ok(Outcome::Done)
        }
        Action::Unpair(unpair) => {
            let (_, folder) = open(&unpair.devices)?;
            if !folder.unpair(&unpair.name)? {
                bail!(
                    "no paired phone is called {:?}; `lsfb sidecar list` shows them",
                    unpair.name
                );
            }
            context.print_ended(&serde_json::json!({ "unpaired": unpair.name }), || {
                format!("{} is unpaired", unpair.name)
            })?;
            Ok(Outcome::Done)
        }
        Action::Play(play) => play.run(context),
        Action::Walks(walks) => super::sidecar_walks::run(walks, context),
    }
}

fn open(devices: &Path) -> anyhow::Result<(SidecarConfig, PairingFolder)> {
    let config = DevicesConfig::read(devices)?;
    let sidecar = config
        .sidecar
        .with_context(|| format!("{}: there is no [sidecar]", devices.display()))?;
    let folder = PairingFolder::open(&sidecar.folder)?;
    Ok((sidecar, folder))
}

impl Pair {
    fn run(&self, context: &Context) -> anyhow::Result<Outcome> {
        let (sidecar, folder) = open(&self.devices)?;
        let host = match (self.address, sidecar.listen.ip()) {
            (Some(host), _) => host,
            (None, listen) if !listen.is_unspecified() => listen,
            (None, _) => way_out().context("give this machine's address with --address")?,
        };
        if let Some(name) = &self.push {
            return self.invite_pusher(name, host, &sidecar, &folder, context);
        }
        let valid = Duration::from_secs(self.valid_secs.into());
        let code = PairingCode {
            address: SocketAddr::new(host, sidecar.listen.port()).to_string(),
            fingerprint: folder.fingerprint(),
            token: folder.invite(valid)?,
        };
        let text = match self.browser {
            true => code.to_link(),
            false => code.to_text(),
        };
        let picture = qr_code::of(&text);
        let valid_secs = self.valid_secs;
        context.print_ended(
            &serde_json::json!({ "code": text, "valid_secs": valid_secs }),
            || format!("{picture}{text}\nPairs one phone, within {valid_secs} s. Do not show it to anyone else."),
        )?;
        Ok(Outcome::Done)
    }
}

impl Pair {
    fn invite_pusher(
        &self,
        name: &str,
        host: IpAddr,
        sidecar: &SidecarConfig,
        folder: &PairingFolder,
        context: &Context,
    ) -> anyhow::Result<Outcome> {
        let listen = sidecar.push_listen.with_context(|| {
            format!(
                "{}: [sidecar] has no push_listen, the address for apps that push over plain HTTP, such as \"0.0.0.0:8791\"",
                self.devices.display()
            )
        })?;
        let key = to_hex(&folder.invite_pusher(name, self.units)?.0);
        let at = SocketAddr::new(host, listen.port());
        let url = format!("http://{at}/v1/push/{name}/{key}");
        let picture = qr_code::of(&url);
        context.print_ended(&serde_json::json!({ "url": url }), || {
            format!(
                "{picture}{url}\nSensor Logger's push URL for {name}, until `lsfb sidecar unpair \
                 {name}`. Do not show it to anyone else; it is not encrypted on the network."
            )
        })?;
        Ok(Outcome::Done)
    }
}

/// This machine's address towards other networks.
fn way_out() -> std::io::Result<IpAddr> {
    let socket = UdpSocket::bind("0.0.0.0:0")?;
    socket.connect(ELSEWHERE)?;
    Ok(socket.local_addr()?.ip())
}

impl Play {
    fn run(&self, context: &Context) -> anyhow::Result<Outcome> {
        let playback = Playback::open(&self.recording)?;
        let device = match (&self.device, playback.sidecars()) {
            (Some(name), known) if known.contains(name) => name.clone(),
            (None, [only]) => only.clone(),
            (_, []) => bail!("{}: it has no phone", self.recording.display()),
            (_, known) => bail!(BadArgument::new(format!(
                "{}: choose one of its phones with --device: {}",
                self.recording.display(),
                known.join(", ")
            ))),
        };
        let mut addresses = self
            .code
            .address
            .to_socket_addrs()
            .with_context(|| self.code.address.clone())?;
        let address = addresses
            .next()
            .with_context(|| format!("{} has no address", self.code.address))?;
        let rig = ClientConfig {
            device: device.clone(),
            session: self.session.clone(),
            reconnect_secs: self.reconnect_secs,
            faults: self.fault_seed,
            ..ClientConfig::invited(address, &self.code)?
        };
        let endpoints = PlaybackEndpoints {
            sidecars: BTreeMap::from([(device, rig)]),
            ..PlaybackEndpoints::nowhere()
        };
        let session = playback.of_sidecars().start(
            &endpoints,
            Pace::RealTimes(self.speed),
            Turns::Times(1),
        )?;
        let sent = session.join(&|p| context.show(p))?;
        let report = serde_json::json!({
            "recording": self.recording,
            "messages": sent.sidecar_messages,
            "unreadable": sent.unreadable,
        });
        context.print_ended(&report, || {
            format!(
                "{}: {} messages sent and stored",
                self.recording.display(),
                sent.sidecar_messages
            )
        })?;
        Ok(match sent.unreadable {
            0 => Outcome::Done,
            _ => Outcome::DataLost,
        })
    }
}
