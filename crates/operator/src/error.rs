use std::net::SocketAddr;

/// Why there is no screen.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The address cannot be listened on.
    #[error("cannot listen on {address}: {cause}; is another program there?")]
    Listen {
        /// The address.
        address: SocketAddr,
        /// Why.
        #[source]
        cause: std::io::Error,
    },
    /// Other machines can reach the address, and nothing keeps them out.
    #[error(
        "{address} can be reached from other machines: a PIN of at least four characters is needed"
    )]
    Pin {
        /// The address.
        address: SocketAddr,
    },
    /// No thread could be started.
    #[error("thread {name}: {cause}")]
    Thread {
        /// The thread.
        name: &'static str,
        /// Why.
        #[source]
        cause: std::io::Error,
    },
}
