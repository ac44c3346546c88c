use std::net::SocketAddr;

/// Why there is no server.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The address cannot be listened on.
    #[error("cannot listen on {address}: {cause}; is another program using it?")]
    Listen {
        /// The address.
        address: SocketAddr,
        /// Why.
        #[source]
        cause: std::io::Error,
    },
    /// No thread could be started.
    #[error("threads of the server {name}: {cause}")]
    Threads {
        /// The server.
        name: &'static str,
        /// Why.
        #[source]
        cause: std::io::Error,
    },
}
