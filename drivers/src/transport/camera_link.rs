//! The host's side of a camera, whatever is at its path: a V4L2 capture node, or the socket of a mock unit.

use std::io;
use std::os::unix::fs::FileTypeExt;
use std::path::Path;
use std::time::Duration;

use lsfb_types::Packet;

use super::PacketSource;
use super::camera_socket::SocketLink;
#[cfg(feature = "hardware")]
use super::v4l2::NodeLink;
use crate::Error;
use crate::transport::uvc::{FrameFormat, ImageControl, LinkCounters, XuQuery, XuSelector};

/// A link to one camera: frames, and transactions with its extension unit.
#[derive(Debug)]
pub struct CameraLink {
    wire: Wire,
}

#[derive(Debug)]
enum Wire {
    Socket(SocketLink),
    #[cfg(feature = "hardware")]
    Node(NodeLink),
}

impl CameraLink {
    /// Opens what is at `path`. A capture node needs the feature `hardware`.
    pub fn open(path: &Path) -> Result<Self, Error> {
        let failed = |action, cause| Error::Open {
            device: path.display().to_string(),
            action,
            cause,
        };
        let kind = std::fs::metadata(path)
            .map_err(|cause| failed("find the camera", cause))?
            .file_type();
        let wire = if kind.is_socket() {
            Wire::Socket(SocketLink::connect(path)?)
        } else if kind.is_char_device() {
            open_node(path)?
        } else {
            return Err(failed(
                "open the camera",
                io::Error::new(
                    io::ErrorKind::InvalidInput,
                    "neither a capture node nor the socket of a mock camera",
                ),
            ));
        };
        Ok(Self { wire })
    }

    /// The path as the user named it.
    pub fn device(&self) -> &str {
        match &self.wire {
            Wire::Socket(link) => link.device(),
            #[cfg(feature = "hardware")]
            Wire::Node(link) => link.device(),
        }
    }

    /// Asks for frames.
    pub fn start(&mut self, format: FrameFormat, rate_hz: u32) -> Result<(), Error> {
        match &mut self.wire {
            Wire::Socket(link) => link.start(format, rate_hz),
            #[cfg(feature = "hardware")]
            Wire::Node(link) => link.start(format, rate_hz),
        }
    }

    /// Writes to the extension unit.
    pub fn xu_set(&mut self, selector: XuSelector, bytes: &[u8]) -> Result<(), Error> {
        match &mut self.wire {
            Wire::Socket(link) => link.xu_set(selector, bytes),
            #[cfg(feature = "hardware")]
            Wire::Node(link) => link.xu_set(selector, bytes),
        }
    }

    /// Reads from the extension unit: all bytes of the channel.
    pub fn xu_get(&mut self, selector: XuSelector, query: XuQuery) -> Result<Vec<u8>, Error> {
        match &mut self.wire {
            Wire::Socket(link) => link.xu_get(selector, query),
            #[cfg(feature = "hardware")]
            Wire::Node(link) => link.xu_get(selector, query),
        }
    }

    /// Sets a control of the image sensors.
    pub fn control_set(&mut self, control: ImageControl, value: i32) -> Result<(), Error> {
        match &mut self.wire {
            Wire::Socket(link) => link.control_set(control, value),
            #[cfg(feature = "hardware")]
            Wire::Node(link) => link.control_set(control, value),
        }
    }

    /// Current value of a control of the image sensors.
    pub fn control_get(&mut self, control: ImageControl) -> Result<i32, Error> {
        match &mut self.wire {
            Wire::Socket(link) => link.control_get(control),
            #[cfg(feature = "hardware")]
            Wire::Node(link) => link.control_get(control),
        }
    }

    /// What the link has met so far. A socket loses nothing and counts nothing.
    pub fn counters(&self) -> LinkCounters {
        match &self.wire {
            Wire::Socket(_) => LinkCounters::default(),
            #[cfg(feature = "hardware")]
            Wire::Node(link) => link.counters(),
        }
    }
}

impl PacketSource for CameraLink {
    fn recv(&mut self, timeout: Duration) -> Result<Option<Packet>, Error> {
        match &mut self.wire {
            Wire::Socket(link) => link.recv(timeout),
            #[cfg(feature = "hardware")]
            Wire::Node(link) => link.recv(timeout),
        }
    }
}

#[cfg(feature = "hardware")]
fn open_node(path: &Path) -> Result<Wire, Error> {
    NodeLink::open(path).map(Wire::Node)
}

#[cfg(not(feature = "hardware"))]
fn open_node(path: &Path) -> Result<Wire, Error> {
    Err(built_without_nodes(path))
}

/// Compiled for tests too, so that one build of them tests what programs with and without hardware say.
#[cfg(any(test, not(feature = "hardware")))]
fn built_without_nodes(path: &Path) -> Error {
    Error::Open {
        device: path.display().to_string(),
        action: "open the camera node",
        cause: io::Error::new(
            io::ErrorKind::Unsupported,
            "this build supports mock cameras only; build it with `--features hardware`",
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_camera_says_what_it_is() {
        let dir = tempfile::tempdir().unwrap();
        let open = |path: &Path| CameraLink::open(path).unwrap_err().to_string();
        let absent = open(&dir.path().join("mynt_front"));
        assert!(absent.contains("cannot find the camera"), "{absent}");
        let folder = open(dir.path());
        assert!(folder.contains("neither a capture node nor"), "{folder}");
        let node = open(Path::new("/dev/null"));
        let expected = if cfg!(feature = "hardware") {
            "not a V4L2 capture node"
        } else {
            "--features hardware"
        };
        assert!(node.contains(expected), "{node}");
        let without = built_without_nodes(Path::new("/dev/null")).to_string();
        assert!(without.contains("--features hardware"), "{without}");
    }
}
