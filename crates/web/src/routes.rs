//! Who answers which request.

use std::collections::BTreeMap;
use std::net::IpAddr;
use std::pin::Pin;
use std::sync::atomic::AtomicU64;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use hyper::body::Incoming;
use hyper::{Request, StatusCode};
use tokio::sync::watch;

use crate::answers::{Answer, said};
use crate::limits::{ConnectionLimits, Ticket};
use crate::refusals::Refusals;

/// An answer on its way.
type Answering = Pin<Box<dyn Future<Output = Answer> + Send>>;
/// What answers requests.
pub type Handler = Arc<dyn Fn(Request<Incoming>, Visit) -> Answering + Send + Sync>;

/// A handler of a function.
pub fn handler<F>(answer: impl Fn(Request<Incoming>, Visit) -> F + Send + Sync + 'static) -> Handler
where
    F: Future<Output = Answer> + Send + 'static,
{
    Arc::new(move |request, visit| Box::pin(answer(request, visit)))
}

/// One connection, whoever it is.
#[derive(Clone, Debug)]
pub struct Visit {
    /// Its number.
    pub connection: u64,
    /// Where it comes from; an IPv4 address as such, where the socket hears both families.
    pub peer: IpAddr,
    /// Whether it came by TLS.
    pub is_secure: bool,
    /// Its place among those who have not said who they are.
    pub ticket: Arc<Ticket>,
    /// Who is refused is counted there.
    pub refusals: Arc<Refusals>,
    /// Changes when this address is not listened on any more.
    pub running: watch::Receiver<()>,
}

/// What all addresses of a server share.
#[derive(Clone, Debug, Default)]
pub(crate) struct Door {
    pub limits: Arc<ConnectionLimits>,
    pub refusals: Arc<Refusals>,
    /// Connections so far, whoever came by them.
    pub connections: Arc<AtomicU64>,
}

/// Who answers what: by the first word of the path, and by none what no other word takes.
#[derive(Clone, Default)]
pub(crate) struct Routes(Arc<Mutex<BTreeMap<&'static str, (u64, Handler)>>>);

impl Routes {
    pub(crate) fn lock(&self) -> MutexGuard<'_, BTreeMap<&'static str, (u64, Handler)>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Answers one request.
    pub(crate) async fn answer(&self, request: Request<Incoming>, visit: Visit) -> Answer {
        let handler = {
            let mounted = self.lock();
            let path = request.uri().path().trim_start_matches('/');
            let word = path.split('/').next().unwrap_or_default();
            let found = mounted.get(word).or_else(|| mounted.get(""));
            found.map(|(_, handler)| Arc::clone(handler))
        };
        match handler {
            Some(handler) => handler(request, visit).await,
            None => said(
                StatusCode::SERVICE_UNAVAILABLE,
                "nothing is being recorded; phones can connect while a recording runs",
            ),
        }
    }
}
