//! The server as a process, and a client of HTTP/1.1 that sends what it is told byte by byte.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

/// How long an answer may take.
const ANSWERING: Duration = Duration::from_secs(30);

/// A running `foresight-server serve`, ended when dropped.
pub(crate) struct Server {
    pub(crate) child: Child,
    pub(crate) port: u16,
    log: tempfile::NamedTempFile,
}

impl Server {
    /// Serves a world under the name `w`, with further options.
    pub(crate) fn start(world: &str, options: &[&str]) -> Server {
        let log = tempfile::NamedTempFile::new().expect("a temporary file");
        let mut child = Command::new(env!("CARGO_BIN_EXE_foresight-server"))
            .args(["serve", "--listen", "127.0.0.1:0", "--world"])
            .arg(format!("w={world}"))
            .args(options)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(log.reopen().expect("the same file"))
            .spawn()
            .expect("the server starts");
        let mut line = String::new();
        BufReader::new(child.stdout.take().expect("standard output is piped")).read_line(&mut line).expect("a line");
        let port = line.trim().strip_prefix("listening on http://127.0.0.1:").and_then(|port| port.parse().ok());
        let port = port.unwrap_or_else(|| panic!("{line:?}"));
        Server { child, port, log }
    }

    /// Serves a folder with [`write_world`] in it.
    pub(crate) fn with_files(folder: &Path) -> Server {
        write_world(folder);
        Server::start(folder.to_str().expect("a path in UTF-8"), &[])
    }

    /// What it has written to standard error.
    pub(crate) fn log(&self) -> String {
        std::fs::read_to_string(self.log.path()).expect("the log can be read")
    }

    pub(crate) fn url(&self, path: &str) -> String {
        format!("http://127.0.0.1:{}{path}", self.port)
    }

    pub(crate) fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(("127.0.0.1", self.port)).expect("the server listens");
        stream.set_read_timeout(Some(ANSWERING)).expect("a timeout can be set");
        stream
    }

    /// The answer to a request on a connection of its own.
    pub(crate) fn ask(&self, method: &str, target: &str, fields: &[(&str, &str)]) -> Answer {
        let mut stream = self.connect();
        let fields: String = fields.iter().map(|(name, value)| format!("{name}: {value}\r\n")).collect();
        write!(stream, "{method} {target} HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n{fields}\r\n")
            .expect("the request is written");
        let mut bytes = Vec::new();
        stream.read_to_end(&mut bytes).expect("the answer is read");
        Answer::parse(&bytes)
    }

    pub(crate) fn get(&self, target: &str, fields: &[(&str, &str)]) -> Answer {
        self.ask("GET", target, fields)
    }

    /// The world's base, `/worlds/w/IDENTITY/`.
    pub(crate) fn base(&self) -> String {
        let text = String::from_utf8(self.get("/worlds/w", &[]).body).expect("JSON");
        let after = text.split("\"base\":\"").nth(1).expect("a base");
        after.split('"').next().expect("its end").to_owned()
    }

    /// A number in `/metrics`.
    pub(crate) fn metric(&self, name: &str) -> f64 {
        let text = String::from_utf8(self.get("/metrics", &[]).body).expect("text");
        let line = text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(' '));
        line.and_then(|value| value.parse().ok()).unwrap_or_else(|| panic!("{name} in {text}"))
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // Gone already where the test has ended it.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// An answer; names of fields in small letters.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Answer {
    pub(crate) status: u16,
    pub(crate) fields: BTreeMap<String, String>,
    pub(crate) body: Vec<u8>,
}

impl Answer {
    pub(crate) fn parse(bytes: &[u8]) -> Answer {
        let end = bytes.windows(4).position(|part| part == b"\r\n\r\n");
        let end = end.unwrap_or_else(|| panic!("no head in {:?}", String::from_utf8_lossy(bytes)));
        let head = std::str::from_utf8(&bytes[..end]).expect("a head in ASCII");
        let mut lines = head.split("\r\n");
        let status = lines.next().and_then(|line| line.split(' ').nth(1)?.parse().ok()).expect("a status");
        let fields = lines.filter_map(|line| line.split_once(": "));
        let fields = fields.map(|(name, value)| (name.to_ascii_lowercase(), value.to_owned())).collect();
        Answer { status, fields, body: bytes[end + 4..].to_vec() }
    }

    /// A field; empty if it is not there.
    pub(crate) fn field(&self, name: &str) -> &str {
        self.fields.get(name).map_or("", String::as_str)
    }
}

/// Length of `big.glb`: more than is kept in memory.
pub(crate) const BIG: usize = 3 << 20;

/// Bytes in which each place differs from its neighbours.
pub(crate) fn content(bytes: usize) -> Vec<u8> {
    (0..bytes as u32).flat_map(|i| (i.wrapping_mul(2_654_435_761) >> 8).to_le_bytes()).take(bytes).collect()
}

/// A tileset with `a.glb`, `big.glb` and `a b.glb`; `a.glb` is there compressed too, and there are a folder, a hidden file, and
/// links within the folder and out of it.
pub(crate) fn write_world(folder: &Path) {
    let write = |name: &str, bytes: &[u8]| std::fs::write(folder.join(name), bytes).expect("a file can be written");
    let tile = |uri: &str| {
        format!(
            r#"{{"boundingVolume":{{"box":[0,0,0,9,0,0,0,9,0,0,0,9]}},"geometricError":0,"content":{{"uri":"{uri}"}}}}"#
        )
    };
    let tileset = format!(
        r#"{{"asset":{{"version":"1.1"}},"geometricError":9,"root":{{"boundingVolume":{{"box":[0,0,0,9,0,0,0,9,0,0,0,9]}},
        "geometricError":5,"refine":"ADD","content":{{"uri":"a.glb"}},"children":[{},{}]}}}}"#,
        tile("big.glb"),
        tile("a%20b.glb")
    );
    write("tileset.json", tileset.as_bytes());
    for (name, bytes) in [("a.glb", 5000), ("big.glb", BIG), ("a b.glb", 200)] {
        write(name, &padded_glb(bytes));
    }
    write("a.glb.gz", b"\x1f\x8bgzip");
    write("a.glb.br", b"brotli");
    write("inflated.json", b"\x1f\x8bnot what it says");
    write(".hidden", b"secret");
    std::fs::create_dir(folder.join("sub")).expect("a folder can be made");
    write("sub/data.bin", b"data");
    #[cfg(unix)]
    {
        let outside = folder.with_extension("outside");
        std::fs::write(&outside, "secret").expect("a file can be written");
        for (to, name) in [("a.glb", "inside.glb"), ("/etc/passwd", "passwd"), ("..", "up"), ("../../..", "sub/top")] {
            std::os::unix::fs::symlink(to, folder.join(name)).expect("a link can be made");
        }
        std::os::unix::fs::symlink(&outside, folder.join("outside.txt")).expect("a link can be made");
    }
}

/// A binary glTF of one triangle, with a chunk of [`content`] at its end.
pub(crate) fn padded_glb(bytes: usize) -> Vec<u8> {
    let corners = [[-4f32, -4., -4.], [4., -4., -4.], [4., 4., 4.]];
    let positions: Vec<u8> = corners.iter().flatten().flat_map(|c| c.to_le_bytes()).collect();
    let mut json = br#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],"nodes":[{"mesh":0}],"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],"accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[-4,-4,-4],"max":[4,4,4]}],"bufferViews":[{"buffer":0,"byteLength":36}],"buffers":[{"byteLength":36}]}"#
        .to_vec();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut glb = b"glTF\x02\0\0\0\0\0\0\0".to_vec();
    for (kind, chunk) in [(b"JSON", &json), (b"BIN\0", &positions)] {
        glb.extend_from_slice(&(chunk.len() as u32).to_le_bytes());
        glb.extend_from_slice(kind);
        glb.extend_from_slice(chunk);
    }
    if let Some(rest) = bytes.checked_sub(glb.len() + 8) {
        glb.extend_from_slice(&(rest as u32).to_le_bytes());
        glb.extend_from_slice(b"PADD");
        glb.extend_from_slice(&content(rest));
    }
    let length = glb.len() as u32;
    glb[8..12].copy_from_slice(&length.to_le_bytes());
    glb
}
