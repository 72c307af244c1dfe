//! `serve`: worlds over HTTP.

use std::io::Write;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, bail};
use clap::Args;

use foresight_traces::link;
use utoipa_axum::router::OpenApiRouter;

use crate::http::{self, limits::Limits, listener, state::AppState, worlds::Worlds};

/// Options of `serve`.
#[derive(Clone, Debug, Args)]
#[command(
    after_help = "Examples:\n  foresight-server serve --world tiles/\n  foresight-server serve --world old=tiles-2024/ --world new=tiles/\n  \
                  foresight-server serve --world city:blocks=20 --link constant:20Mbit,40ms --listen 127.0.0.1:0"
)]
pub struct ServeArgs {
    /// A world: a folder, a 3D Tiles tileset.json, a generated world (file or parameters, such as city:blocks=20), a city model,
    /// an elevation grid. Its name is that of its folder, or NAME in NAME=PATH. Several can be given
    #[arg(long = "world", value_name = "[NAME=]WORLD", required = true, num_args = 1..)]
    worlds: Vec<String>,
    /// Address and port to listen on; port 0 takes a free one
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:8080")]
    listen: SocketAddr,
    /// Link at whose pace each session's responses are sent, such as constant:20Mbit,40ms or a recorded one; as fast as they go
    /// if not given. Requests that name no session share one link
    #[arg(long, value_name = "LINK")]
    link: Option<String>,
}

/// Sessions that have a link of their own at a time.
const SESSIONS_MAX: usize = 1000;

/// Serves until the process is told to end by SIGINT or SIGTERM.
///
/// # Errors
/// A world that cannot be opened, or an address that cannot be listened on.
pub fn run(arguments: ServeArgs) -> anyhow::Result<()> {
    if !arguments.listen.ip().is_loopback() {
        bail!("--listen {}: reachable from other machines; expected a loopback address", arguments.listen);
    }
    let worlds = Worlds::open(&arguments.worlds)?;
    let link = arguments.link.as_deref().map(link::parse::from_specification).transpose()?;
    let state = Arc::new(AppState::new(worlds, link, SESSIONS_MAX, Limits::default(), |_| {}));
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    runtime.block_on(async {
        let listener = tokio::net::TcpListener::bind(arguments.listen)
            .await
            .with_context(|| format!("{} cannot be listened on", arguments.listen))?;
        {
            let mut out = std::io::stdout().lock();
            writeln!(out, "listening on http://{}", listener.local_addr()?)?;
            out.flush()?;
        }
        let router = http::router(state.clone(), OpenApiRouter::new());
        listener::serve(listener, router, state, stop()).await;
        anyhow::Ok(())
    })?;
    runtime.shutdown_timeout(Duration::from_secs(1));
    Ok(())
}

/// Ends at SIGINT or SIGTERM.
async fn stop() {
    let interrupt = async {
        // Without a handler the system's own ends the process.
        if tokio::signal::ctrl_c().await.is_err() {
            std::future::pending::<()>().await;
        }
    };
    #[cfg(unix)]
    {
        use tokio::signal::unix::{SignalKind, signal};
        match signal(SignalKind::terminate()) {
            Ok(mut terminate) => {
                tokio::select! { () = interrupt => {}, _ = terminate.recv() => {} }
            }
            Err(_) => interrupt.await,
        }
    }
    #[cfg(not(unix))]
    interrupt.await;
}
