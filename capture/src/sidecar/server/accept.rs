//! TCP and TLS: from a listener to HTTP requests.

use std::convert::Infallible;
use std::net::IpAddr;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use hyper::Request;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::{Service, service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::time::{sleep, timeout};
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::ServerConfig;

use super::answers::Answer;
use super::{INTRODUCTION, Shared, Visit, routes};

/// How long TLS, and then the head of a request, may take.
const HANDSHAKE: Duration = Duration::from_secs(5);
/// Pause after a connection could not be accepted: for want of file descriptors, say.
const PAUSE: Duration = Duration::from_millis(50);
/// Longest head of a request, bytes.
const MAX_HEAD_BYTES: usize = 16 << 10;

/// Accepts until `running` ends; without TLS only what is pushed.
pub(super) async fn accept_all(
    listener: TcpListener,
    tls: Option<Arc<ServerConfig>>,
    shared: Arc<Shared>,
    mut running: watch::Receiver<()>,
) {
    let tls = tls.map(TlsAcceptor::from);
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
        let connection = shared.connections.fetch_add(1, Ordering::Relaxed) + 1;
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

async fn serve(tcp: TcpStream, tls: Option<TlsAcceptor>, visit: Visit) {
    // An error shows when something is sent.
    let _ = tcp.set_nodelay(true);
    let Some(tls) = tls else {
        let service =
            |visit| service_fn(move |request| routes::answer_pushed(request, Visit::clone(&visit)));
        return serve_http(tcp, visit.clone(), service(visit)).await;
    };
    let refusals = Arc::clone(&visit.shared.refusals);
    let stream = match timeout(HANDSHAKE, tls.accept(tcp)).await {
        Ok(Ok(stream)) => stream,
        Ok(Err(_)) => return refusals.count("no TLS"),
        Err(_) => return refusals.count("slow TLS"),
    };
    let service = |visit| service_fn(move |request| routes::answer(request, Visit::clone(&visit)));
    serve_http(stream, visit.clone(), service(visit)).await;
}

async fn serve_http<Io, S>(stream: Io, visit: Visit, service: S)
where
    Io: AsyncRead + AsyncWrite + Unpin + Send + 'static,
    S: Service<Request<Incoming>, Response = Answer, Error = Infallible>,
    S::Future: Send + 'static,
{
    let (ticket, mut running) = (Arc::clone(&visit.ticket), visit.running.clone());
    let refusals = Arc::clone(&visit.shared.refusals);
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
