use std::net::SocketAddr;

/// Why there is no screen.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The server does not serve.
    #[error(transparent)]
    Server(#[from] lsfb_web::Error),
    /// Other machines can reach the address, and could read and change what is said there.
    #[error(
        "{address} can be reached from other machines, to which the screen is served over TLS only"
    )]
    Plain {
        /// The address.
        address: SocketAddr,
    },
    /// Other machines can reach the address, and nothing keeps them out.
    #[error(
        "{address} can be reached from other machines: a PIN of at least four characters is needed"
    )]
    Pin {
        /// The address.
        address: SocketAddr,
    },
}
