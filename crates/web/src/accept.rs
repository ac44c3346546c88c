//! TCP and TLS: from a listener to HTTP requests.

use std::convert::Infallible;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::io::{AsyncRead, AsyncWrite, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::time::{sleep, timeout};
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::ServerConfig;

use crate::routes::{Door, Routes, Visit};

/// How long TLS, and then the head of a request, may take.
const HANDSHAKE: Duration = Duration::from_secs(5);
/// How long a connection may take to say who it is.
const INTRODUCTION: Duration = Duration::from_secs(10);
/// Pause after a connection could not be accepted: for want of file descriptors, say.
const PAUSE: Duration = Duration::from_millis(50);
/// Longest head of a request, bytes.
const MAX_HEAD_BYTES: usize = 16 << 10;
/// What is said to a browser that was sent here by a link without TLS.
const SPEAKS_TLS: &[u8] =
    b"HTTP/1.1 400 Bad Request\r\nContent-Type: text/plain\r\nConnection: close\r\n\r\n\
    this address speaks TLS: open it with https:// before it\n";

/// Accepts until `running` ends.
pub(crate) async fn accept_all(
    listener: TcpListener,
    tls: Option<Arc<ServerConfig>>,
    routes: Routes,
    door: Door,
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
        let peer = peer.ip().to_canonical();
        let ticket = Arc::new(door.limits.wait(peer));
        let visit = Visit {
            connection: door.connections.fetch_add(1, Ordering::Relaxed) + 1,
            peer,
            is_secure: tls.is_some(),
            ticket: Arc::clone(&ticket),
            refusals: Arc::clone(&door.refusals),
            running: running.clone(),
        };
        let refusals = Arc::clone(&door.refusals);
        let (tls, routes) = (tls.clone(), routes.clone());
        tokio::spawn(async move {
            tokio::select! {
                () = serve(tcp, tls, routes, visit) => {}
                () = ticket.sent_away() => refusals.count("disconnected to make room for others"),
            }
        });
    }
}

async fn serve(mut tcp: TcpStream, tls: Option<TlsAcceptor>, routes: Routes, visit: Visit) {
    // An error shows when something is sent.
    let _ = tcp.set_nodelay(true);
    let Some(tls) = tls else {
        return serve_http(tcp, routes, visit).await;
    };
    let mut first = [0];
    match timeout(HANDSHAKE, tcp.peek(&mut first)).await {
        // The first letter of a method of HTTP; TLS begins with 22.
        Ok(Ok(1..)) if first.first().is_some_and(u8::is_ascii_uppercase) => {
            visit.refusals.count("no TLS");
            // It may have gone.
            let _ = timeout(HANDSHAKE, tcp.write_all(SPEAKS_TLS)).await;
            let _ = timeout(HANDSHAKE, tcp.shutdown()).await;
            return;
        }
        Ok(_) => {}
        Err(_) => return visit.refusals.count("slow TLS"),
    }
    match timeout(HANDSHAKE, tls.accept(tcp)).await {
        Ok(Ok(stream)) => serve_http(stream, routes, visit).await,
        Ok(Err(_)) => visit.refusals.count("no TLS"),
        Err(_) => visit.refusals.count("slow TLS"),
    }
}

async fn serve_http<Io>(stream: Io, routes: Routes, visit: Visit)
where
    Io: AsyncRead + AsyncWrite + Unpin + Send + 'static,
{
    let (ticket, mut running) = (Arc::clone(&visit.ticket), visit.running.clone());
    let refusals = Arc::clone(&visit.refusals);
    let service = service_fn(move |request| {
        let (routes, visit) = (routes.clone(), visit.clone());
        async move { Ok::<_, Infallible>(routes.answer(request, visit).await) }
    });
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HANDSHAKE)
        .max_buf_size(MAX_HEAD_BYTES)
        // Who has said all gets an answer all the same.
        .half_close(true)
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
        () = introduced => refusals.count("did not identify itself"),
        _ = running.changed() => {}
    }
}
