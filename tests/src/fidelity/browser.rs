//! Chromium without a screen, and the packages that its pages load.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::time::Duration;

use foresight_scheduler::lod_tree::RepId;
use foresight_sim::stopwatch::Stopwatch;
use serde::Deserialize;

use super::case::Case;
use super::server::{Pages, Said, Server};
use super::{Asked, Recorded, Viewer, page};

/// Real time that a page may take beside the flight.
const SPARE: Duration = Duration::from_secs(90);

const PACKAGE: &str = include_str!("../../fidelity/package.json");
const LOCK: &str = include_str!("../../fidelity/package-lock.json");
const PLAY: &str = include_str!("../../fidelity/play.js");

/// Chromium's arguments: nothing is fetched but from this machine, timers run as if the page were looked at, and WebGL is
/// drawn in software.
pub(crate) const ARGUMENTS: [&str; 16] = [
    "--headless",
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-extensions",
    "--disable-default-apps",
    "--disable-background-timer-throttling",
    "--disable-renderer-backgrounding",
    "--disable-backgrounding-occluded-windows",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--window-size=320,240",
    "--host-resolver-rules=MAP *.localhost 127.0.0.1, MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
];

/// Why a viewer could not be run.
#[derive(Debug, thiserror::Error)]
pub enum BrowserError {
    /// A program is missing.
    #[error("no {0} in PATH; tests/run --full installs Debian's packages chromium, nodejs and npm")]
    Missing(&'static str),
    /// The packages cannot be installed.
    #[error("npm ci: {0}")]
    Packages(String),
    /// A file, a process or a connection failed.
    #[error(transparent)]
    Io(#[from] std::io::Error),
    /// The page reported an error.
    #[error("the page says: {0}")]
    Page(String),
    /// The page reported nothing in time.
    #[error("the page reported nothing within {0} s")]
    Silent(u64),
}

/// Chromium, with the viewers' packages installed.
#[derive(Clone, Debug)]
pub struct Browser {
    pub(super) program: PathBuf,
    pub(super) packages: PathBuf,
}

/// What the page reports.
#[derive(Deserialize)]
struct Report {
    requests: Vec<(f64, u32)>,
    frames: u64,
    seconds: f64,
    longest_frame: f64,
}

impl Browser {
    /// Finds Chromium, and installs the packages into `folder` unless they are there.
    pub fn install(folder: &Path) -> Result<Browser, BrowserError> {
        let program = in_path("chromium").ok_or(BrowserError::Missing("chromium"))?;
        let npm = in_path("npm").ok_or(BrowserError::Missing("npm"))?;
        let stamp = folder.join("installed");
        if std::fs::read_to_string(&stamp).ok().as_deref() != Some(LOCK) {
            std::fs::create_dir_all(folder)?;
            std::fs::write(folder.join("package.json"), PACKAGE)?;
            std::fs::write(folder.join("package-lock.json"), LOCK)?;
            let output = Command::new(npm)
                .args(["ci", "--ignore-scripts", "--no-audit", "--no-fund"])
                .current_dir(folder)
                .stdin(Stdio::null())
                .output()?;
            if !output.status.success() {
                return Err(BrowserError::Packages(String::from_utf8_lossy(&output.stderr).into_owned()));
            }
            std::fs::write(stamp, LOCK)?;
        }
        Ok(Browser { program, packages: folder.to_owned() })
    }

    /// Plays the case before the viewer, in real time.
    pub fn run(&self, viewer: &Viewer, case: &Arc<Case>) -> Result<Recorded, BrowserError> {
        let mut files = BTreeMap::new();
        let mut add = |at: &str, kind, bytes: &[u8]| files.insert(at.to_owned(), (kind, bytes.to_vec()));
        add("/", "text/html", viewer.page.as_bytes());
        add("/play.js", "text/javascript", PLAY.as_bytes());
        add("/case.json", "application/json", page::setup(case).to_string().as_bytes());
        add("/world/tileset.json", "application/json", page::tileset(&case.world.tree).to_string().as_bytes());
        let contents = Arc::clone(case);
        let content = Box::new(move |rep: RepId| contents.content(rep));
        let server = Server::start(Pages { files, packages: self.packages.clone(), content }, case.link.clone())?;

        let profile = tempfile::tempdir()?;
        let mut chromium = Running(
            Command::new(&self.program)
                .args(ARGUMENTS)
                .arg(format!("--user-data-dir={}", profile.path().display()))
                .arg(format!("http://page.localhost:{}/", server.port))
                .stdin(Stdio::null())
                .stdout(Stdio::null())
                .stderr(Stdio::null())
                .spawn()?,
        );
        let limit = Duration::from_nanos(case.flight.duration().0) + SPARE;
        let said = chromium.hear(&server, limit)?;
        let traffic = server.traffic();
        drop(chromium);
        let report: Report = match said {
            Said::Failure(message) => return Err(BrowserError::Page(message)),
            Said::Result(bytes) => {
                serde_json::from_slice(&bytes).map_err(|error| BrowserError::Page(error.to_string()))?
            }
        };
        let requests = report.requests.iter().map(|&(at_s, rep)| Asked { at_s, rep: RepId(rep) }).collect();
        Ok(Recorded {
            requests,
            frames: report.frames,
            seconds: report.seconds,
            longest_frame_s: report.longest_frame,
            cancelled: traffic.cancelled,
            bytes: traffic.bytes,
        })
    }
}

/// A process that ends with its owner.
pub(super) struct Running(pub(super) Child);

impl Running {
    /// What the page says, or that it said nothing in time, or that the browser has ended.
    pub(super) fn hear(&mut self, server: &Server, limit: Duration) -> Result<Said, BrowserError> {
        let clock = Stopwatch::start();
        loop {
            if let Ok(said) = server.said.recv_timeout(Duration::from_millis(200)) {
                return Ok(said);
            }
            if let Some(status) = self.0.try_wait()? {
                return Err(BrowserError::Page(format!("the browser has ended: {status}")));
            }
            if u128::from(clock.nanos()) > limit.as_nanos() {
                return Err(BrowserError::Silent(limit.as_secs()));
            }
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

pub(crate) fn in_path(program: &str) -> Option<PathBuf> {
    std::env::split_paths(&std::env::var_os("PATH")?).map(|folder| folder.join(program)).find(|file| file.is_file())
}

/// A folder for the packages beside what cargo builds: `fidelity` in the target directory of the running program.
pub fn packages_folder() -> std::io::Result<PathBuf> {
    let program = std::env::current_exe()?;
    let target = program.ancestors().find(|folder| folder.join("CACHEDIR.TAG").is_file());
    Ok(target.or(program.parent()).map_or_else(|| PathBuf::from("."), Path::to_owned).join("fidelity"))
}
