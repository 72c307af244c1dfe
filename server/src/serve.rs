//! `serve`: worlds over HTTP, and sessions for the clients that fly through them.

use std::io::Write;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context;
use clap::Args;
use foresight_traces::link;
use tokio::sync::watch;

use crate::config::{self, Config, Flags, Loaded};
use crate::http::{self, limits::Limits, listener, state::AppState, worlds::Worlds};
use crate::log;
use crate::session::access::{self, Access};
use crate::session::metrics::SessionMetrics;
use crate::session::{self, Host};

/// Options of `serve`.
#[derive(Clone, Debug, Args)]
#[command(
    after_help = "Every setting can also stand in the file, as KEY = VALUE, or in the environment, as FORESIGHT_KEY; a flag beats a \
variable, a variable the file. The token that clients must know comes from FORESIGHT_TOKEN or --token-file.\n\n\
Examples:\n  foresight-server serve --world tiles/\n  foresight-server serve --world old=tiles-2024/ --world new=tiles/\n  \
foresight-server serve --world city:blocks=20 --link constant:20Mbit,40ms --listen 127.0.0.1:0\n  \
FORESIGHT_TOKEN=… foresight-server serve --config foresight.toml --listen 0.0.0.0:8080 --record recordings/\n  \
foresight-server serve --world tiles/ --print-config > foresight.toml"
)]
pub struct ServeArgs {
    /// File with settings (TOML); FORESIGHT_CONFIG may name it instead
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Write the effective settings as such a file and end
    #[arg(long)]
    print_config: bool,
    #[command(flatten)]
    flags: Flags,
}

/// Serves until the process is told to end by SIGINT or SIGTERM; a second signal ends it at once.
///
/// # Errors
/// A setting that is not what was expected, a world that cannot be opened, or an address that cannot be listened on.
pub fn run(arguments: &ServeArgs) -> anyhow::Result<()> {
    let file = arguments.config.clone().or_else(|| std::env::var_os("FORESIGHT_CONFIG").map(PathBuf::from));
    let variables =
        std::env::vars_os().filter_map(|(name, value)| Some((name.into_string().ok()?, value.into_string().ok()?)));
    let Loaded { config, token, warnings } = config::load(file.as_deref(), variables, &arguments.flags)?;
    if arguments.print_config {
        std::io::stdout().lock().write_all(config.to_toml().as_bytes())?;
        return Ok(());
    }
    log::begin(config.log, &config.log_levels);
    for warning in warnings {
        tracing::warn!("{warning}");
    }
    let worlds = Worlds::open(&config.world)?;
    let link = config.link.as_deref().map(link::parse::from_specification).transpose()?;
    let metrics = SessionMetrics::default();
    let state = AppState::new(worlds, link, config.sessions_max.count(), limits(&config), |registry| {
        metrics.register(registry);
    });
    let state = Arc::new(state);
    let access = Arc::new(Access::new(&config, token));
    let (listen, within) = (config.listen, config.shutdown_within.0);
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let host = Host::start(config, state.clone(), metrics)?;
    let in_time = runtime.block_on(async {
        let listener =
            tokio::net::TcpListener::bind(listen).await.with_context(|| format!("{listen} cannot be listened on"))?;
        {
            let mut out = std::io::stdout().lock();
            writeln!(out, "listening on http://{}", listener.local_addr()?)?;
            out.flush()?;
        }
        let (stop, mut stopped) = watch::channel(false);
        tokio::spawn(signals(stop));
        let degraded = Arc::downgrade(&host);
        state.tell_degraded(move || degraded.upgrade().and_then(|host| host.degraded()));
        let router = http::router(state.clone(), session::routes(host.clone()))
            .layer(axum::middleware::from_fn_with_state(access, access::guard));
        let mut told = stopped.clone();
        let serving = listener::serve(listener, router, state, async move {
            let _ = told.wait_for(|stopped| *stopped).await;
        });
        let closing = async {
            let _ = stopped.wait_for(|stopped| *stopped).await;
            tracing::info!("shutting down");
            host.stop(within).await
        };
        let ((), in_time) = tokio::join!(serving, closing);
        anyhow::Ok(in_time)
    })?;
    runtime.shutdown_timeout(Duration::from_millis(100));
    if in_time {
        tracing::info!("all sessions are closed");
    } else {
        tracing::warn!("not all sessions could be closed within {within:?}");
    }
    Ok(())
}

fn limits(config: &Config) -> Limits {
    Limits {
        connections: config.connections_max.count(),
        requests: config.requests_max.count(),
        bodies: config.requests_max.count(),
        head_within: config.head_within.0,
        idle: config.connection_idle_after.0,
        store_bytes: config.store_bytes.0,
        shutdown: config.shutdown_within.0,
        ..Limits::default()
    }
}

/// Tells of the first signal; the second ends the process.
async fn signals(stop: watch::Sender<bool>) {
    signal().await;
    stop.send_replace(true);
    signal().await;
    std::process::exit(130);
}

/// SIGINT or SIGTERM.
async fn signal() {
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
