//! Where phones and glasses connect.

use std::net::SocketAddr;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

/// Where phones and glasses connect.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SidecarConfig {
    /// Address to listen on; port 0 takes a free one.
    pub listen: SocketAddr,
    /// Address to listen on for apps that push by plain HTTP (Sensor Logger); what they send, and their key, can be read by whoever
    /// is on the network.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub push_listen: Option<SocketAddr>,
    /// Folder of the rig's certificate and of the devices that are paired with it; made where it is not there.
    #[serde(default = "sidecar_folder")]
    pub folder: PathBuf,
    /// How long a device that was lost is waited for where nothing else is recorded, seconds.
    #[serde(default = "come_back_secs")]
    pub come_back_secs: u32,
    /// Whether identifiers of access points and beacons are replaced by keyed hashes before they are recorded.
    #[serde(default)]
    pub hash_identifiers: bool,
}

lsfb_types::bounds! {
    SidecarConfig {
        listen: any,
        push_listen: any,
        folder: any,
        come_back_secs: any,
        hash_identifiers: any,
    }
}

fn sidecar_folder() -> PathBuf {
    PathBuf::from("sidecar")
}

fn come_back_secs() -> u32 {
    120
}

impl SidecarConfig {
    /// Listens there, and knows devices by this folder.
    pub fn new(listen: SocketAddr, folder: PathBuf) -> Self {
        Self {
            listen,
            push_listen: None,
            folder,
            come_back_secs: come_back_secs(),
            hash_identifiers: false,
        }
    }
}
