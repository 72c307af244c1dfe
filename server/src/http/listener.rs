//! Takes connections and speaks HTTP/1.1 or HTTP/2 (without TLS, by prior knowledge) on them.

use std::convert::Infallible;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;

use axum::Router;
use axum::body::Body;
use axum::extract::ConnectInfo;
use axum::http::{Request, StatusCode};
use axum::response::{IntoResponse, Response};
use hyper::body::Incoming;
use hyper::service::Service;
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use hyper_util::server::conn::auto;
use hyper_util::server::graceful::GracefulShutdown;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::OwnedSemaphorePermit;
use tower::ServiceExt;

use super::connection::{Activity, Watched};
use super::problem::Problem;
use super::state::AppState;
use crate::clock;

/// What a connection too many is told.
const FULL: &[u8] =
    b"HTTP/1.1 503 Service Unavailable\r\nretry-after: 1\r\ncontent-length: 0\r\nconnection: close\r\n\r\n";

/// Serves until `stop` ends; then takes no connection any more, says so on `/health/ready`, and waits for responses
/// under way as long as the limits say.
pub async fn serve(listener: TcpListener, router: Router, state: Arc<AppState>, stop: impl Future<Output = ()>) {
    let builder = Arc::new(builder(&state));
    let graceful = GracefulShutdown::new();
    let mut stop = std::pin::pin!(stop);
    loop {
        let (stream, peer) = tokio::select! {
            () = &mut stop => break,
            accepted = listener.accept() => match accepted {
                Ok(accepted) => accepted,
                Err(error) => {
                    // Out of file descriptors, say: connections that end make room.
                    tracing::warn!(%error, "a connection cannot be taken");
                    tokio::time::sleep(std::time::Duration::from_millis(50)).await;
                    continue;
                }
            },
        };
        let Ok(permit) = state.connections.clone().try_acquire_owned() else {
            state.metrics.closed("too many");
            // Fits into the empty buffer of a new socket, or the client learns nothing.
            let _ = stream.try_write(FULL);
            continue;
        };
        let (builder, watcher) = (builder.clone(), graceful.watcher());
        let (router, state) = (router.clone(), state.clone());
        tokio::spawn(async move { connection(stream, peer, router, state, &builder, watcher, permit).await });
    }
    drop(listener);
    state.set_ready(false);
    let patience = state.limits.shutdown;
    if tokio::time::timeout(patience, graceful.shutdown()).await.is_err() {
        tracing::warn!("responses still under way after {patience:?} are broken off");
    }
}

fn builder(state: &AppState) -> auto::Builder<TokioExecutor> {
    let limits = &state.limits;
    let mut builder = auto::Builder::new(TokioExecutor::new());
    builder
        .http1()
        .timer(TokioTimer::new())
        .header_read_timeout(limits.head_within)
        .max_headers(limits.head_fields)
        // Hyper asks for room for 8 KiB at least.
        .max_buf_size(limits.head_bytes.max(8192));
    builder
        .http2()
        .timer(TokioTimer::new())
        .max_concurrent_streams(limits.streams)
        .max_header_list_size(u32::try_from(limits.head_bytes).unwrap_or(u32::MAX));
    builder
}

async fn connection(
    stream: TcpStream,
    peer: SocketAddr,
    router: Router,
    state: Arc<AppState>,
    builder: &auto::Builder<TokioExecutor>,
    watcher: hyper_util::server::graceful::Watcher,
    _permit: OwnedSemaphorePermit,
) {
    // A socket that refuses the option works without.
    let _ = stream.set_nodelay(true);
    let activity = Activity::new();
    let requests = Requests { router, state: state.clone(), activity: activity.clone(), peer };
    let io = TokioIo::new(Watched::new(stream, activity.clone()));
    let connection = builder.serve_connection_with_upgrades(io, requests).into_owned();
    let mut connection = std::pin::pin!(watcher.watch(connection));
    let (first, idle) = (state.limits.head_within, state.limits.idle);
    let mut look = tokio::time::interval(first.min(idle).div_f64(4.0).max(std::time::Duration::from_millis(10)));
    state.metrics.connections_active.inc();
    loop {
        tokio::select! {
            ended = &mut connection => {
                if let Err(error) = ended {
                    tracing::debug!(%peer, %error, "a connection broke off");
                }
                break;
            }
            _ = look.tick() => if activity.is_over(first, idle) {
                state.metrics.closed("idle");
                break;
            },
        }
    }
    state.metrics.connections_active.dec();
}

/// The requests of a connection.
#[derive(Clone)]
struct Requests {
    router: Router,
    state: Arc<AppState>,
    activity: Arc<Activity>,
    peer: SocketAddr,
}

impl Service<Request<Incoming>> for Requests {
    type Response = Response;
    type Error = Infallible;
    type Future = Pin<Box<dyn Future<Output = Result<Response, Infallible>> + Send>>;

    fn call(&self, request: Request<Incoming>) -> Self::Future {
        let requests = self.clone();
        Box::pin(async move { Ok(requests.answer(request).await) })
    }
}

impl Requests {
    async fn answer(self, request: Request<Incoming>) -> Response {
        let asked_at = clock::now();
        let _owed = self.activity.request();
        let metrics = &self.state.metrics;
        let target = request.uri().path_and_query().map_or(0, |target| target.as_str().len());
        let response = if target > self.state.limits.target_bytes {
            metrics.refused("target");
            let most = self.state.limits.target_bytes;
            Problem::new(StatusCode::URI_TOO_LONG, format!("a target of {target} bytes; expected at most {most}"))
                .into_response()
        } else if let Ok(_permit) = self.state.requests.try_acquire() {
            metrics.requests_active.inc();
            let mut request = request.map(Body::new);
            request.extensions_mut().insert(ConnectInfo(self.peer));
            request.extensions_mut().insert(self.activity.clone());
            let response = match self.router.oneshot(request).await {
                Ok(response) => response,
                Err(never) => match never {},
            };
            metrics.requests_active.dec();
            response
        } else {
            metrics.refused("requests");
            Problem::busy("as many requests are being answered as may be", 1).into_response()
        };
        metrics.responded(response.status(), asked_at);
        response
    }
}
