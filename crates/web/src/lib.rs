//! The one HTTP server: phones send to it, operators look at their page on it, the leaderboard takes uploads by it.
//!
//! A [`Server`] has the threads and counts strangers; a [`Listener`] is an address of it, with TLS or without; what is mounted at a
//! listener answers requests below one word of the path. Everything that a stranger can reach has a limit in size, number and
//! time: connections that have not said who they are make room for others ([`Ticket`]), heads and TLS have five seconds.
//!
//! ```no_run
//! use std::sync::Arc;
//! use lsfb_web::{Listener, Server, StatusCode, handler, said};
//! let server = Server::start("site")?;
//! let listener = Listener::open(&server, ([127, 0, 0, 1], 0).into(), None)?;
//! let mount = listener.mount("", handler(|_request, _visit| async { said(StatusCode::OK, "hello") }));
//! # drop(mount);
//! # Ok::<(), lsfb_web::Error>(())
//! ```

mod accept;
mod answers;
mod error;
mod form;
mod limits;
mod names;
mod refusals;
mod routes;
mod server;
mod websocket;

pub use answers::{Answer, file_of, json_of, said, said_aloud, under};
pub use error::Error;
pub use form::{Field, body, fields};
pub use hyper::body::Incoming;
pub use hyper::{Method, Request, StatusCode};
pub use limits::{Ticket, network_of};
pub use names::{Names, is_own_page};
pub use refusals::Refusals;
pub use routes::{Handler, Visit, handler};
pub use server::{Listener, Mount, Server, blocking};
pub use tokio_rustls::rustls::ServerConfig;
pub use websocket::{Socket, offered, upgrade};
