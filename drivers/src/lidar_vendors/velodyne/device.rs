//! Opens the pair of UDP ports that a sensor sends to.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};

use super::model::FACTORY_PORTS;
use crate::Error;
use crate::lidar::RECEIVE_BUFFER_BYTES;
use crate::transport::udp::{UdpConfig, UdpSource};

/// Where a sensor's packets arrive.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct VelodyneConfig {
    /// Address and port for data packets; port 0 takes a free one.
    pub data_bind: SocketAddr,
    /// Address and port for position packets; port 0 takes a free one.
    pub position_bind: SocketAddr,
    /// Take packets from this sensor only; several sensors share the factory ports.
    pub sensor: Option<IpAddr>,
    /// Wanted kernel receive buffer, bytes.
    pub receive_buffer_bytes: usize,
}

impl Default for VelodyneConfig {
    /// The factory ports on all interfaces, any sensor, four seconds of data.
    fn default() -> Self {
        let any = IpAddr::V4(Ipv4Addr::UNSPECIFIED);
        let [data, position] = FACTORY_PORTS;
        Self {
            data_bind: SocketAddr::new(any, data),
            position_bind: SocketAddr::new(any, position),
            sensor: None,
            receive_buffer_bytes: RECEIVE_BUFFER_BYTES,
        }
    }
}

/// Binds both ports. Packets of both come out in the order of arrival and are told apart by their length.
pub fn open(config: &VelodyneConfig) -> Result<UdpSource, Error> {
    UdpSource::bind(&UdpConfig {
        binds: vec![config.data_bind, config.position_bind],
        sender: config.sensor,
        receive_buffer_bytes: config.receive_buffer_bytes,
    })
}
