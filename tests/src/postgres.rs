//! A PostgreSQL server of the test's own: in a temporary folder, on a free port of 127.0.0.1, gone afterwards.

use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::Command;

/// A running server with an empty database.
#[derive(Debug)]
pub struct Server {
    folder: String,
    bin: PathBuf,
    url: String,
}

impl Server {
    /// Starts one, as the user `postgres` where this process is the superuser, as whom the server refuses to run.
    ///
    /// # Panics
    /// If PostgreSQL is not installed or does not start.
    pub fn start() -> Server {
        let bin = programs();
        let folder = run("mktemp", &["-d"]).trim().to_owned();
        let data = format!("{folder}/data");
        let program = |name: &str| bin.join(name).display().to_string();
        run(&program("initdb"), &["-D", &data, "-U", "postgres", "-A", "trust", "-E", "UTF8", "--no-sync"]);
        let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
        let port = listener.local_addr().expect("its address").port();
        drop(listener);
        let options =
            format!("-p {port} -c listen_addresses=127.0.0.1 -c unix_socket_directories={folder} -c fsync=off");
        run(&program("pg_ctl"), &["-D", &data, "-w", "-l", &format!("{folder}/log"), "-o", &options, "start"]);
        Server { folder, bin, url: format!("postgres://postgres@127.0.0.1:{port}/postgres") }
    }

    /// Its database.
    pub fn url(&self) -> &str {
        &self.url
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let stop = self.bin.join("pg_ctl").display().to_string();
        // By the process number in the folder, so that no other server is meant.
        run(&stop, &["-D", &format!("{}/data", self.folder), "-m", "immediate", "stop"]);
        run("rm", &["-r", &self.folder]);
    }
}

/// The folder with `initdb`, of the newest version installed.
fn programs() -> PathBuf {
    let versions = std::fs::read_dir("/usr/lib/postgresql").into_iter().flatten().flatten();
    let mut found: Vec<PathBuf> =
        versions.map(|v| v.path().join("bin")).filter(|b| b.join("initdb").is_file()).collect();
    found.sort();
    found.pop().expect("initdb under /usr/lib/postgresql; `apt-get install postgresql` brings it")
}

/// Runs a program, in the root folder, which every user may enter; gives its output.
fn run(program: &str, arguments: &[&str]) -> String {
    let superuser = Command::new("id").arg("-u").output().is_ok_and(|output| output.stdout == b"0\n");
    let mut command = if superuser {
        let mut command = Command::new("runuser");
        command.args(["-u", "postgres", "--", program]);
        command
    } else {
        Command::new(program)
    };
    // A server inherits what it is started with: no pipe that would keep this process waiting for its end.
    let output = tempfile::NamedTempFile::new().expect("a temporary file");
    let file = || output.reopen().expect("it opens again");
    let status = command.args(arguments).current_dir(Path::new("/")).stdout(file()).stderr(file()).status();
    let text = std::fs::read_to_string(output.path()).expect("text");
    assert!(status.is_ok_and(|status| status.success()), "{program} {arguments:?}\n{text}");
    text
}
