//! TCP and TLS: from a listener to HTTP requests.

use std::net::IpAddr;
use std::sync::Arc;
use std::time::Duration;

use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::time::{sleep, timeout};
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::ServerConfig;

use super::{INTRODUCTION, Shared, Visit, routes};

/// How long TLS, and then the head of a request, may take.
const HANDSHAKE: Duration = Duration::from_secs(5);
/// Pause after a connection could not be accepted: for want of file descriptors, say.
const PAUSE: Duration = Duration::from_millis(50);
/// Longest head of a request, bytes.
const MAX_HEAD_BYTES: usize = 16 << 10;

/// Accepts until `running` ends.
pub(super) async fn accept_all(
    listener: TcpListener,
    tls: Arc<ServerConfig>,
    shared: Arc<Shared>,
    mut running: watch::Receiver<()>,
) {
    let tls = TlsAcceptor::from(tls);
    let mut connection = 0;
    loop {
        let accepted = tokio::select! {
            // Its sender is dropped, never used.
            _ = running.changed() => return,
            accepted = listener.accept() => accepted,
        };
        let Ok((tcp, peer)) = accepted else {
            // It concerns one app; the listener stays.
            sleep(PAUSE).await;
            continue;
        };
        connection += 1;
        let ticket = Arc::new(shared.limits.wait(unmapped(peer.ip())));
        let visit = Visit {
            connection,
            ticket: Arc::clone(&ticket),
            shared: Arc::clone(&shared),
            running: running.clone(),
        };
        let refusals = Arc::clone(&shared.refusals);
        let tls = tls.clone();
        tokio::spawn(async move {
            tokio::select! {
                () = serve(tcp, tls, visit) => {}
                () = ticket.sent_away() => refusals.count("made room for others"),
            }
        });
    }
}

async fn serve(tcp: TcpStream, tls: TlsAcceptor, visit: Visit) {
    // An error shows when something is sent.
    let _ = tcp.set_nodelay(true);
    let refusals = Arc::clone(&visit.shared.refusals);
    let stream = match timeout(HANDSHAKE, tls.accept(tcp)).await {
        Ok(Ok(stream)) => stream,
        Ok(Err(_)) => return refusals.count("no TLS"),
        Err(_) => return refusals.count("slow TLS"),
    };
    let (ticket, mut running) = (Arc::clone(&visit.ticket), visit.running.clone());
    let service = service_fn(move |request| routes::answer(request, visit.clone()));
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HANDSHAKE)
        .max_buf_size(MAX_HEAD_BYTES)
        .serve_connection(TokioIo::new(stream), service)
        .with_upgrades();
    let mut connection = std::pin::pin!(connection);
    let introduced = async {
        sleep(INTRODUCTION).await;
        if ticket.is_inside() {
            std::future::pending::<()>().await;
        }
    };
    tokio::select! {
        served = &mut connection => if served.is_err() {
            refusals.count("bad HTTP");
        },
        () = introduced => refusals.count("did not say who it is"),
        _ = running.changed() => {}
    }
}

/// An IPv4 address as such, where the socket hears both families.
fn unmapped(address: IpAddr) -> IpAddr {
    address.to_canonical()
}
