//! Accepts a few connections, one thread each.

use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread::{Builder, JoinHandle};
use std::time::Duration;

use crate::Error;

/// Clients at a time: a phone, a tablet, a laptop, and what they left hanging.
const MAX_CLIENTS: usize = 16;
/// How often a new connection is looked for.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// Listens until it is dropped.
#[derive(Debug)]
pub struct Server {
    address: SocketAddr,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

/// Tells a connection's thread when to end.
#[derive(Clone, Debug)]
pub struct Stop(Arc<AtomicBool>);

impl Stop {
    /// Whether it is to end.
    pub fn is_set(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

impl Server {
    /// Has `serve` talk to each client.
    pub fn start(
        name: &'static str,
        address: SocketAddr,
        serve: impl Fn(TcpStream, &Stop) + Send + Sync + 'static,
    ) -> Result<Self, Error> {
        let listen = |cause| Error::Listen { address, cause };
        let listener = TcpListener::bind(address).map_err(listen)?;
        listener.set_nonblocking(true).map_err(listen)?;
        let bound = listener.local_addr().map_err(listen)?;
        let stop = Arc::new(AtomicBool::new(false));
        let told = Stop(Arc::clone(&stop));
        let thread = Builder::new()
            .name(name.to_owned())
            .spawn(move || accept(name, &listener, &told, &Arc::new(serve)))
            .map_err(|cause| Error::Thread { name, cause })?;
        Ok(Self {
            address: bound,
            stop,
            thread: Some(thread),
        })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A panic there has been reported by the panic hook already.
            let _ = thread.join();
        }
    }
}

fn accept(
    name: &str,
    listener: &TcpListener,
    stop: &Stop,
    serve: &Arc<impl Fn(TcpStream, &Stop) + Send + Sync + 'static>,
) {
    let clients = Arc::new(AtomicUsize::new(0));
    while !stop.is_set() {
        match listener.accept() {
            Ok((stream, _)) if clients.load(Ordering::Relaxed) < MAX_CLIENTS => {
                clients.fetch_add(1, Ordering::Relaxed);
                let (serve, stop, mine) = (Arc::clone(serve), stop.clone(), Arc::clone(&clients));
                let started = Builder::new()
                    .name(format!("{name}-client"))
                    .spawn(move || {
                        serve(stream, &stop);
                        mine.fetch_sub(1, Ordering::Relaxed);
                    });
                if started.is_err() {
                    clients.fetch_sub(1, Ordering::Relaxed);
                }
            }
            // Too many: closing it tells the client to come back.
            Ok((stream, _)) => drop(stream),
            // Nobody, or somebody who left at once.
            Err(_) => std::thread::sleep(LOOK_EVERY),
        }
    }
    // The state that clients look at outlives them.
    while clients.load(Ordering::Relaxed) > 0 {
        std::thread::sleep(LOOK_EVERY);
    }
}
