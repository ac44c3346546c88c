//! How many connections may wait before they have said who they are. Strangers are many, quick and patient; a paired device must get in
//! whatever they do, so the oldest
//! stranger of the busiest address makes room for whoever comes.

use std::collections::BTreeMap;
use std::net::IpAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::Notify;

/// Connections that have not said who they are, at most.
const MAX_WAITING: usize = 48;
/// Attempts of one address that may fail within [`FORGOTTEN_AFTER`] before its invitations are not looked at any more.
const MAX_FAILURES: u32 = 10;
const FORGOTTEN_AFTER: Duration = Duration::from_secs(60);
/// Addresses whose failures are remembered at most.
const MAX_ADDRESSES: usize = 1_024;

/// Who has one IPv6 address has all of its network: the network of an address, which is itself in IPv4.
pub fn network_of(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(own) => IpAddr::V6((own.to_bits() >> 64 << 64).into()),
        own => own,
    }
}

/// What waits, and which addresses failed too often.
#[derive(Debug, Default)]
pub(crate) struct ConnectionLimits {
    waiting: Mutex<Waiting>,
    failures: Mutex<BTreeMap<IpAddr, Failures>>,
}

#[derive(Debug, Default)]
struct Waiting {
    next: u64,
    tickets: BTreeMap<u64, (IpAddr, Arc<Notify>)>,
}

#[derive(Debug)]
struct Failures {
    since: Instant,
    count: u32,
}

/// A place at the door, until it is released or dropped.
#[derive(Debug)]
pub struct Ticket {
    limits: Arc<ConnectionLimits>,
    number: u64,
    address: IpAddr,
    sent_away: Arc<Notify>,
    is_inside: AtomicBool,
}

impl ConnectionLimits {
    /// Takes a place; whoever must make room for it is told.
    pub(crate) fn wait(self: &Arc<Self>, address: IpAddr) -> Ticket {
        let address = network_of(address);
        let sent_away = Arc::new(Notify::new());
        let mut waiting = lock(&self.waiting);
        if waiting.tickets.len() >= MAX_WAITING {
            let mut by_address: BTreeMap<IpAddr, (usize, u64)> = BTreeMap::new();
            for (number, (from, _)) in waiting.tickets.iter().rev() {
                let entry = by_address.entry(*from).or_default();
                // In the end the oldest.
                *entry = (entry.0 + 1, *number);
            }
            let busiest = by_address.values().max_by_key(|(count, _)| *count);
            if let Some(number) = busiest.map(|(_, oldest)| *oldest)
                && let Some((_, told)) = waiting.tickets.remove(&number)
            {
                told.notify_one();
            }
        }
        let number = waiting.next;
        waiting.next += 1;
        waiting
            .tickets
            .insert(number, (address, Arc::clone(&sent_away)));
        Ticket {
            limits: Arc::clone(self),
            number,
            address,
            sent_away,
            is_inside: AtomicBool::new(false),
        }
    }
}

impl Ticket {
    /// Until somebody else needs the place.
    pub async fn sent_away(&self) {
        self.sent_away.notified().await;
    }

    /// It is known who this is: the place at the door is free.
    pub fn enter(&self) {
        self.is_inside.store(true, Ordering::Release);
        lock(&self.limits.waiting).tickets.remove(&self.number);
    }

    /// Whether it is known who this is.
    pub fn is_inside(&self) -> bool {
        self.is_inside.load(Ordering::Acquire)
    }

    /// An attempt has failed.
    pub fn fail(&self) {
        let mut failures = lock(&self.limits.failures);
        failures.retain(|_, f| f.since.elapsed() < FORGOTTEN_AFTER);
        if failures.len() >= MAX_ADDRESSES && !failures.contains_key(&self.address) {
            // Whoever has so many addresses is not slowed down by this; a token has 128 bits.
            return;
        }
        let entry = failures.entry(self.address).or_insert_with(|| Failures {
            since: Instant::now(),
            count: 0,
        });
        entry.count += 1;
    }

    /// Whether too many attempts of this address failed lately.
    pub fn is_barred(&self) -> bool {
        let failures = lock(&self.limits.failures);
        failures
            .get(&self.address)
            .is_some_and(|f| f.count >= MAX_FAILURES && f.since.elapsed() < FORGOTTEN_AFTER)
    }
}

impl Drop for Ticket {
    fn drop(&mut self) {
        lock(&self.limits.waiting).tickets.remove(&self.number);
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use std::future::Future as _;
    use std::pin::pin;
    use std::task::{Context, Waker};

    use super::*;

    fn is_sent_away(ticket: &Ticket) -> bool {
        let mut context = Context::from_waker(Waker::noop());
        pin!(ticket.sent_away()).poll(&mut context).is_ready()
    }

    #[test]
    fn the_oldest_of_the_busiest_address_makes_room() {
        let limits = Arc::new(ConnectionLimits::default());
        let (phone, crowd) = (IpAddr::from([10, 0, 0, 1]), IpAddr::from([10, 0, 0, 2]));
        let first = limits.wait(phone);
        let strangers: Vec<Ticket> = (0..200).map(|_| limits.wait(crowd)).collect();
        assert!(!is_sent_away(&first));
        let away = strangers.iter().filter(|t| is_sent_away(t)).count();
        assert_eq!(away, 200 - (MAX_WAITING - 1));
        assert!(!is_sent_away(strangers.last().unwrap()));
        first.enter();
        drop(strangers);
        assert!(lock(&limits.waiting).tickets.is_empty() && first.is_inside());
    }

    /// Whoever has one address of an IPv6 network has all of them.
    #[test]
    fn a_network_is_one_stranger() {
        let of = |text: &str| text.parse().expect("address");
        let limits = Arc::new(ConnectionLimits::default());
        let one = limits.wait(of("2001:db8::1"));
        (0..MAX_FAILURES).for_each(|_| one.fail());
        assert!(limits.wait(of("2001:db8::2:3")).is_barred());
        assert!(!limits.wait(of("2001:db8:0:1::1")).is_barred());
        assert_eq!(network_of(of("::ffff:10.0.0.1")), of("10.0.0.1"));
    }

    #[test]
    fn an_address_whose_attempts_fail_is_barred_alone() {
        let limits = Arc::new(ConnectionLimits::default());
        let (one, other) = (
            limits.wait([10, 0, 0, 1].into()),
            limits.wait([10, 0, 0, 2].into()),
        );
        (0..MAX_FAILURES).for_each(|_| one.fail());
        assert!(one.is_barred() && !other.is_barred());
    }
}
