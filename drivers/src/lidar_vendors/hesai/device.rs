//! Opens the pair of UDP ports that a sensor sends to.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};

use super::model::FACTORY_PORTS;
use crate::Error;
use crate::lidar::{Page, RECEIVE_BUFFER_BYTES};
use crate::transport::udp::{UdpConfig, UdpSource};

/// These sensors have a web page; it is not known here how they are set by it.
pub const PAGE: Option<Page> = None;

/// Where a sensor's packets arrive.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HesaiConfig {
    /// Address and port for data packets; port 0 takes a free one.
    pub data_bind: SocketAddr,
    /// Address and port for packets about its GPS input; port 0 takes a free one.
    pub gps_bind: SocketAddr,
    /// Take packets from this sensor only.
    pub sensor: Option<IpAddr>,
    /// Wanted kernel receive buffer, bytes.
    pub receive_buffer_bytes: usize,
}

impl Default for HesaiConfig {
    /// The factory ports on all interfaces, any sensor, two seconds of data.
    fn default() -> Self {
        let any = IpAddr::V4(Ipv4Addr::UNSPECIFIED);
        let [data, gps] = FACTORY_PORTS;
        Self {
            data_bind: SocketAddr::new(any, data),
            gps_bind: SocketAddr::new(any, gps),
            sensor: None,
            receive_buffer_bytes: RECEIVE_BUFFER_BYTES,
        }
    }
}

/// Binds both ports. Packets of both come out in the order of arrival and are told apart by their length.
pub fn open(config: &HesaiConfig) -> Result<UdpSource, Error> {
    UdpSource::bind(&UdpConfig {
        binds: vec![config.data_bind, config.gps_bind],
        sender: config.sensor,
        receive_buffer_bytes: config.receive_buffer_bytes,
    })
}
