//! `serve`: worlds over HTTP.

use std::io::Write;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context;
use clap::Args;

use crate::http::{self, listener, metrics::Metrics, state::AppState, store::Store, worlds::Worlds};

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
}

/// Serves until the process is told to end by SIGINT or SIGTERM.
///
/// # Errors
/// A world that cannot be opened, or an address that cannot be listened on.
pub fn run(arguments: ServeArgs) -> anyhow::Result<()> {
    let worlds = Worlds::open(&arguments.worlds)?;
    let state = Arc::new(AppState { worlds, store: Store::new(256 << 20), metrics: Metrics::default() });
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
        listener::serve(listener, http::router(state), stop(), Duration::from_secs(10)).await?;
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
