//! A faulty piece of network between client and server: it forwards every connection, and spoils contents.
//!
//! HTTP/1.1, a thread a connection, one request each; sockets that are upgraded are forwarded as they are.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{Ipv4Addr, Shutdown, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Longest head of a request, bytes.
const HEAD_MAX: u64 = 64 << 10;
/// How long a response that never comes is held.
const NEVER: Duration = Duration::from_secs(3600);

/// What becomes of a content.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// This status instead.
    Status(u16),
    /// The connection breaks in the middle of the body.
    Truncated,
    /// Bytes that are no HTTP.
    Garbage,
    /// Another content of the same length.
    Swapped,
    /// Nothing at all.
    Never,
}

/// Which contents are spoiled.
#[derive(Clone, Copy, Debug)]
pub struct Spoiled {
    /// How.
    pub fault: Fault,
    /// Every so manieth address, by a hash of it.
    pub one_in: u64,
    /// So many times; afterwards it is sound.
    pub times: u32,
}

/// The proxy; it ends with the program.
#[derive(Debug)]
pub struct Proxy {
    port: u16,
    spoiled: Counts,
    sockets: Sockets,
    is_healed: Arc<AtomicBool>,
}

/// How often each address was spoiled.
type Counts = Arc<Mutex<BTreeMap<String, u32>>>;
/// Clients' ends of upgraded sockets.
type Sockets = Arc<Mutex<Vec<TcpStream>>>;

impl Proxy {
    /// Forwards to `server_port`, spoiling contents: what lies below a world's identity.
    ///
    /// # Panics
    /// Without a free port.
    pub fn start(server_port: u16, spoils: Option<Spoiled>) -> Proxy {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a free port");
        let port = listener.local_addr().expect("its address").port();
        let (spoiled, sockets) = (Counts::default(), Sockets::default());
        let (counts, upgraded) = (spoiled.clone(), sockets.clone());
        let is_healed = Arc::new(AtomicBool::new(false));
        let healed = is_healed.clone();
        std::thread::spawn(move || {
            for client in listener.incoming().map_while(Result::ok) {
                let (counts, upgraded) = (counts.clone(), upgraded.clone());
                let spoils = spoils.filter(|_| !healed.load(Ordering::Relaxed));
                std::thread::spawn(move || {
                    // A connection that breaks is what this is for.
                    let _ = serve(client, server_port, spoils.as_ref(), &counts, &upgraded);
                });
            }
        });
        Proxy { port, spoiled, sockets, is_healed }
    }

    /// Its address, as `--server` takes it.
    pub fn url(&self) -> String {
        format!("http://127.0.0.1:{}", self.port)
    }

    /// Breaks the sockets that are open, and answers how many that were.
    pub fn cut(&self) -> usize {
        let sockets = std::mem::take(&mut *self.sockets.lock().unwrap_or_else(PoisonError::into_inner));
        sockets.iter().filter(|socket| socket.shutdown(Shutdown::Both).is_ok()).count()
    }

    /// From now on nothing is spoiled.
    pub fn heal(&self) {
        self.is_healed.store(true, Ordering::Relaxed);
    }

    /// Responses that were spoiled.
    pub fn spoiled(&self) -> u32 {
        self.spoiled.lock().unwrap_or_else(PoisonError::into_inner).values().sum()
    }
}

fn serve(
    client: TcpStream,
    server_port: u16,
    spoils: Option<&Spoiled>,
    counts: &Counts,
    sockets: &Sockets,
) -> std::io::Result<()> {
    client.set_nodelay(true)?;
    let mut reader = BufReader::new(client.try_clone()?.take(HEAD_MAX));
    let mut head = Vec::new();
    while !head.ends_with(b"\r\n\r\n") {
        if reader.read_until(b'\n', &mut head)? == 0 {
            return Ok(());
        }
    }
    let text = String::from_utf8_lossy(&head).into_owned();
    let address = text.split(' ').nth(1).unwrap_or_default().to_owned();
    let upgrades = text.to_ascii_lowercase().contains("\r\nupgrade:");
    let mut server = TcpStream::connect((Ipv4Addr::LOCALHOST, server_port))?;
    server.set_nodelay(true)?;
    if upgrades {
        sockets.lock().unwrap_or_else(PoisonError::into_inner).push(client.try_clone()?);
        server.write_all(&head)?;
        server.write_all(reader.buffer())?;
        let (mut to_client, mut from_server) = (client.try_clone()?, server.try_clone()?);
        let back = std::thread::spawn(move || {
            let _ = std::io::copy(&mut from_server, &mut to_client);
            let _ = to_client.shutdown(Shutdown::Both);
        });
        let mut rest = client;
        let _ = std::io::copy(&mut rest, &mut server);
        let _ = server.shutdown(Shutdown::Both);
        let _ = back.join();
        return Ok(());
    }
    // A request a connection.
    let closing = text.replacen("\r\n", "\r\nConnection: close\r\n", 1);
    let fault = spoils.filter(|spoils| chosen(&address, spoils, counts)).map(|spoils| spoils.fault);
    answer(client, server, closing.as_bytes(), fault)
}

fn answer(mut client: TcpStream, mut server: TcpStream, request: &[u8], fault: Option<Fault>) -> std::io::Result<()> {
    match fault {
        None => {
            server.write_all(request)?;
            // The client gives up by closing; the server is told by the next byte that cannot be written.
            std::io::copy(&mut server, &mut client)?;
        }
        Some(Fault::Status(status)) => {
            write!(client, "HTTP/1.1 {status} Spoiled\r\nContent-Length: 7\r\nConnection: close\r\n\r\nspoiled")?;
        }
        Some(Fault::Garbage) => client.write_all(b"\x00\x01\x02 this is no HTTP \xff\xfe\r\n\r\n")?,
        Some(Fault::Never) => std::thread::sleep(NEVER),
        Some(fault @ (Fault::Truncated | Fault::Swapped)) => {
            server.write_all(request)?;
            let mut response = Vec::new();
            server.read_to_end(&mut response)?;
            let body = response.windows(4).position(|w| w == b"\r\n\r\n").map_or(response.len(), |at| at + 4);
            if fault == Fault::Truncated {
                response.truncate(body + (response.len() - body) / 2);
            } else {
                response[body..].fill(b'?');
            }
            client.write_all(&response)?;
        }
    }
    client.shutdown(Shutdown::Both)
}

/// Whether this request is to be spoiled; it is counted then.
fn chosen(address: &str, spoils: &Spoiled, counts: &Counts) -> bool {
    // /worlds/NAME/IDENTITY/…: the rest is not content.
    if !address.starts_with("/worlds/") || address.split('/').count() < 5 {
        return false;
    }
    // FNV-1a.
    let hash = address
        .bytes()
        .fold(0xcbf2_9ce4_8422_2325u64, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3));
    if !(hash >> 32).is_multiple_of(spoils.one_in) {
        return false;
    }
    let mut counts = counts.lock().unwrap_or_else(PoisonError::into_inner);
    let count = counts.entry(address.to_owned()).or_default();
    *count += 1;
    let spoiled = *count <= spoils.times;
    if !spoiled {
        *count = spoils.times;
    }
    spoiled
}
