//! Threads, addresses, and what is served at them.

use std::fmt;
use std::net::{IpAddr, SocketAddr, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use tokio::net::TcpListener;
use tokio::runtime::{Builder, Runtime};
use tokio::sync::watch;
use tokio_rustls::rustls::ServerConfig;

use crate::Error;
use crate::accept::accept_all;
use crate::refusals::Refusals;
use crate::routes::{Door, Handler, Routes};

/// Threads of the network side.
const THREADS: usize = 2;
/// How long what still runs has when the server ends.
const GOODBYE: Duration = Duration::from_millis(500);
/// An address to ask the way to: nothing is sent there (RFC 5737).
const ELSEWHERE: (&str, u16) = ("192.0.2.1", 9);

/// Work that may take its time, away from the threads of the network; `None` where it panicked.
pub async fn blocking<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> Option<T> {
    tokio::task::spawn_blocking(work).await.ok()
}

/// Threads that serve, until it is dropped.
pub struct Server {
    runtime: Option<Runtime>,
    door: Door,
}

impl fmt::Debug for Server {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Server").finish_non_exhaustive()
    }
}

impl Server {
    /// Starts the threads; nothing is listened on yet.
    pub fn start(name: &'static str) -> Result<Arc<Self>, Error> {
        let runtime = Builder::new_multi_thread()
            .worker_threads(THREADS)
            .thread_name(name)
            .enable_io()
            .enable_time()
            .build()
            .map_err(|cause| Error::Threads { name, cause })?;
        Ok(Arc::new(Self {
            runtime: Some(runtime),
            door: Door::default(),
        }))
    }

    /// Who was refused.
    pub fn refusals(&self) -> Arc<Refusals> {
        Arc::clone(&self.door.refusals)
    }

    /// Waits for something, on a thread that is none of the server's; `None` where it has ended.
    pub fn wait_for<F: Future>(&self, future: F) -> Option<F::Output> {
        Some(self.runtime.as_ref()?.block_on(future))
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            // Who has not gone by then is cut off.
            runtime.shutdown_timeout(GOODBYE);
        }
    }
}

/// An address that is listened on, until it is dropped.
pub struct Listener {
    address: SocketAddr,
    is_secure: bool,
    routes: Routes,
    mounts: AtomicU64,
    /// Dropped with it, which ends its connections.
    _running: watch::Sender<()>,
    server: Arc<Server>,
}

impl fmt::Debug for Listener {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Listener")
            .field("address", &self.address)
            .field("is_secure", &self.is_secure)
            .finish_non_exhaustive()
    }
}

impl Listener {
    /// Begins to listen, by TLS where that is given; port 0 takes a free one.
    pub fn open(
        server: &Arc<Server>,
        address: SocketAddr,
        tls: Option<Arc<ServerConfig>>,
    ) -> Result<Self, Error> {
        let failed = |cause| Error::Listen { address, cause };
        let ended = || failed(std::io::ErrorKind::NotConnected.into());
        let runtime = server.runtime.as_ref().ok_or_else(ended)?;
        let listener = runtime
            .block_on(TcpListener::bind(address))
            .map_err(failed)?;
        let bound = listener.local_addr().map_err(failed)?;
        let (running, ended) = watch::channel(());
        let routes = Routes::default();
        let is_secure = tls.is_some();
        runtime.spawn(accept_all(
            listener,
            tls,
            routes.clone(),
            server.door.clone(),
            ended,
        ));
        Ok(Self {
            address: bound,
            is_secure,
            routes,
            mounts: AtomicU64::new(0),
            _running: running,
            server: Arc::clone(server),
        })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Whether it speaks TLS alone.
    pub fn is_secure(&self) -> bool {
        self.is_secure
    }

    /// The server whose address it is.
    pub fn server(&self) -> &Arc<Server> {
        &self.server
    }

    /// What to open in a browser, from another machine where that is possible: scheme, address and port.
    pub fn url(&self) -> String {
        let scheme = if self.is_secure { "https" } else { "http" };
        let host = match self.address.ip() {
            ip if ip.is_unspecified() => own_address().unwrap_or(ip),
            ip => ip,
        };
        format!("{scheme}://{}", SocketAddr::new(host, self.address.port()))
    }

    /// Has requests whose path begins with `word` answered, until what is returned is dropped; an empty word takes what no other does.
    /// Of two under one word the later answers.
    pub fn mount(&self, word: &'static str, handler: Handler) -> Mount {
        let number = self.mounts.fetch_add(1, Ordering::Relaxed);
        self.routes.lock().insert(word, (number, handler));
        Mount {
            routes: self.routes.clone(),
            word,
            number,
        }
    }
}

/// A handler in its place, until it is dropped.
pub struct Mount {
    routes: Routes,
    word: &'static str,
    number: u64,
}

impl fmt::Debug for Mount {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Mount").field(&self.word).finish()
    }
}

impl Drop for Mount {
    fn drop(&mut self) {
        let mut mounted = self.routes.lock();
        if mounted
            .get(self.word)
            .is_some_and(|(n, _)| *n == self.number)
        {
            mounted.remove(self.word);
        }
    }
}

/// The address by which the local network knows this machine: that of the route to anywhere. Nothing is sent.
fn own_address() -> Option<IpAddr> {
    let socket = UdpSocket::bind("0.0.0.0:0").ok()?;
    socket.connect(ELSEWHERE).ok()?;
    Some(socket.local_addr().ok()?.ip())
}
