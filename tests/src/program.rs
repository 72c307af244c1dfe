//! Runs the built programs in a folder of their own, with a time limit.

use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

/// How often a running program is asked whether it has ended.
const POLL: Duration = Duration::from_millis(10);

/// How a program ended and what it said.
#[derive(Debug)]
pub struct Ended {
    /// Exit code; `None` if a signal ended it.
    pub code: Option<i32>,
    /// Standard output.
    pub stdout: String,
    /// Standard error.
    pub stderr: String,
}

/// Path of a program of this workspace, built before the tests: it lies beside the folder of this test's executable, or
/// beside this program.
/// `foresight-sim` has the store of runs; `foresight-sim-default`, a copy of the default build, has not.
///
/// # Panics
/// If it is not there.
pub fn built(name: &str) -> PathBuf {
    let test = std::env::current_exe().expect("this test knows its own path");
    let beside = test.parent().expect("programs lie in a folder");
    let folder = if beside.ends_with("deps") { beside.parent().expect("tests lie in <profile>/deps") } else { beside };
    let program = folder.join(format!("{name}{}", std::env::consts::EXE_SUFFIX));
    assert!(program.is_file(), "{} is missing; `tests/run` builds it", program.display());
    program
}

/// Runs `foresight-sim` with these arguments in `folder`, without standard input.
///
/// # Panics
/// If it has not ended after `limit`; it is killed first.
pub fn sim(folder: &Path, arguments: &[&str], limit: Duration) -> Ended {
    run("foresight-sim", folder, arguments, &[], limit)
}

/// Runs a program of this workspace as [`sim`] does, with these variables in its environment.
///
/// # Panics
/// As [`sim`].
pub fn run(program: &str, folder: &Path, arguments: &[&str], environment: &[(&str, &Path)], limit: Duration) -> Ended {
    let mut child = Command::new(built(program))
        .args(arguments)
        .envs(environment.iter().copied())
        .current_dir(folder)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    let stdout = drain(child.stdout.take().expect("standard output is piped"));
    let stderr = drain(child.stderr.take().expect("standard error is piped"));
    let code = wait(&mut child, limit);
    let (stdout, stderr) = (text(stdout), text(stderr));
    match code {
        Some(code) => Ended { code, stdout, stderr },
        None => panic!("{program} {arguments:?} still ran after {limit:?}\n{stdout}\n{stderr}"),
    }
}

/// The exit code, or `None` if the limit passed and the program was killed.
pub(crate) fn wait(child: &mut Child, limit: Duration) -> Option<Option<i32>> {
    for _ in 0..limit.as_millis().div_ceil(POLL.as_millis()) {
        if let Some(status) = child.try_wait().expect("a child can be waited for") {
            return Some(status.code());
        }
        std::thread::sleep(POLL);
    }
    child.kill().expect("a child can be killed");
    child.wait().expect("a child can be waited for");
    None
}

pub(crate) fn drain(mut pipe: impl Read + Send + 'static) -> std::thread::JoinHandle<Vec<u8>> {
    std::thread::spawn(move || {
        let mut bytes = Vec::new();
        pipe.read_to_end(&mut bytes).expect("a pipe can be read");
        bytes
    })
}

pub(crate) fn text(reader: std::thread::JoinHandle<Vec<u8>>) -> String {
    String::from_utf8(reader.join().expect("the reader ends")).expect("programs print UTF-8")
}
