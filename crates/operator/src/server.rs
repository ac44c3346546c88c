//! Accepts a few connections, one thread each.

use std::collections::BTreeMap;
use std::net::{IpAddr, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{Builder, JoinHandle};
use std::time::Duration;

use crate::Error;

/// Clients at a time: a phone, a tablet, a laptop, and what they left hanging.
const MAX_CLIENTS: usize = 16;
/// Of these of one network, so that nobody keeps all others out by connections that say nothing. A browser opens six.
const MAX_OF_ONE: usize = 10;
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
    let seats = Seats::default();
    while !stop.is_set() {
        match listener.accept() {
            Ok((stream, from)) => {
                // Too many: closing it tells the client to come back.
                let Some(seat) = seats.take(from.ip()) else {
                    continue;
                };
                let (serve, stop) = (Arc::clone(serve), stop.clone());
                // Where no thread is begun, stream and seat are given back with what it would have done.
                let _ = Builder::new()
                    .name(format!("{name}-client"))
                    .spawn(move || {
                        let _seat = seat;
                        serve(stream, &stop);
                    });
            }
            // Nobody, or somebody who left at once.
            Err(_) => std::thread::sleep(LOOK_EVERY),
        }
    }
    // The state that clients look at outlives them.
    while !seats.are_empty() {
        std::thread::sleep(LOOK_EVERY);
    }
}

/// Who has one IPv6 address has all of its network: the network of an address, which is itself in IPv4.
pub fn network_of(address: IpAddr) -> IpAddr {
    match address {
        IpAddr::V4(_) => address,
        IpAddr::V6(own) => match own.to_ipv4_mapped() {
            Some(own) => IpAddr::V4(own),
            None => IpAddr::V6((own.to_bits() >> 64 << 64).into()),
        },
    }
}

/// Connections at this time, by network.
#[derive(Clone, Default)]
struct Seats(Arc<Mutex<BTreeMap<IpAddr, usize>>>);

/// A connection that counts until it is dropped, also where its thread panics.
struct Seat {
    seats: Seats,
    network: IpAddr,
}

impl Seats {
    fn take(&self, address: IpAddr) -> Option<Seat> {
        let network = network_of(address);
        let mut taken = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let all: usize = taken.values().sum();
        let own = taken.entry(network).or_default();
        // A web server on this machine speaks for many.
        let most_of_one = match network.is_loopback() {
            true => MAX_CLIENTS,
            false => MAX_OF_ONE,
        };
        let is_free = all < MAX_CLIENTS && *own < most_of_one;
        *own += usize::from(is_free);
        taken.retain(|_, count| *count > 0);
        is_free.then(|| Seat {
            seats: self.clone(),
            network,
        })
    }

    fn are_empty(&self) -> bool {
        let taken = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        taken.is_empty()
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        let mut taken = self.seats.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(own) = taken.get_mut(&self.network) {
            *own -= 1;
        }
        taken.retain(|_, count| *count > 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sixteen connections of one stranger kept everybody else out, the operator too.
    #[test]
    fn one_stranger_leaves_room_for_others() {
        let of = |text: &str| text.parse().expect("address");
        let seats = Seats::default();
        let crowd: Vec<Seat> = (0..50).filter_map(|_| seats.take(of("10.0.0.1"))).collect();
        assert_eq!(crowd.len(), MAX_OF_ONE);
        assert!(
            seats.take(of("::ffff:10.0.0.1")).is_none(),
            "the same stranger"
        );
        let mut others: Vec<Seat> = (0..9)
            .filter_map(|i| seats.take(of(&format!("10.0.1.{i}"))))
            .collect();
        assert_eq!(others.len(), MAX_CLIENTS - MAX_OF_ONE);
        drop(crowd);
        // One network, however many addresses it has.
        let network = (0..50).filter_map(|i| seats.take(of(&format!("2001:db8::{i}"))));
        others.extend(network);
        assert_eq!(others.len(), MAX_CLIENTS);
        others.clear();
        assert!(seats.are_empty());
        let own = (0..50).filter_map(|_| seats.take(of("127.0.0.1")));
        assert_eq!(own.collect::<Vec<_>>().len(), MAX_CLIENTS);
    }

    #[test]
    fn a_thread_that_panics_gives_its_seat_back() {
        let seats = Seats::default();
        let seat = seats
            .take("10.0.0.1".parse().expect("address"))
            .expect("free");
        let client = move || {
            let _seat = seat;
            assert_eq!(
                network_of(IpAddr::from([10, 0, 0, 1])),
                IpAddr::from([0; 4])
            );
        };
        let ended = std::panic::catch_unwind(std::panic::AssertUnwindSafe(client));
        assert!(ended.is_err() && seats.are_empty());
    }
}
