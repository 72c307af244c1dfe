//! Threads that read and decode contents, the most wanted first.

use super::compress::Compression;
use super::decode::{DecodeError, Decoded, decode};
use super::source::Source;
use bytes::Bytes;
use foresight_index::world::World;
use foresight_scheduler::lod_tree::RepId;
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

/// How a loader works.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LoaderSettings {
    /// Threads, at least 1.
    pub workers: usize,
    /// Most requests that wait; beyond, the least wanted is refused.
    pub waiting_max: usize,
    /// Once so many decoded bytes wait to be taken, threads wait too.
    pub finished_bytes_max: u64,
}

impl Default for LoaderSettings {
    /// Two threads, 4096 requests, 64 MiB.
    fn default() -> LoaderSettings {
        LoaderSettings { workers: 2, waiting_max: 4096, finished_bytes_max: 64 << 20 }
    }
}

/// What is decoded.
#[derive(Clone, Debug)]
pub enum Input {
    /// Bytes that are there.
    Bytes(Bytes),
    /// Bytes that the source has.
    Source,
}

/// What became of a request.
#[derive(Debug)]
pub struct Loaded {
    /// Of which representation.
    pub rep: RepId,
    /// Its bytes, if they were read here.
    pub bytes: Option<Bytes>,
    /// What it shows, or why not, in words that name it.
    pub result: Result<Decoded, String>,
}

/// Reads and decodes. Dropping it ends its threads after what they are at.
#[derive(Debug)]
pub struct Loader {
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
}

#[derive(Debug)]
struct Shared {
    world: Arc<World>,
    source: Arc<Source>,
    settings: LoaderSettings,
    state: Mutex<State>,
    /// There is something to do, or room for what is done.
    work: Condvar,
    /// Something is done.
    done: Condvar,
}

#[derive(Debug, Default)]
struct State {
    waiting: BTreeMap<Key, (RepId, Input)>,
    keys: BTreeMap<RepId, Key>,
    /// Being worked on, and whether it is still wanted.
    working: BTreeMap<RepId, bool>,
    finished: Vec<Loaded>,
    finished_bytes: u64,
    next: u64,
    /// Of what is decoded from now on.
    compression: Compression,
    is_over: bool,
}

/// The most wanted first, of equals the first asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Key(std::cmp::Reverse<u64>, u64);

/// Ranks in an order of whole numbers: as `f64::total_cmp` has them, NaN last.
fn ordered(rank: f64) -> u64 {
    if rank.is_nan() {
        return 0;
    }
    let bits = rank.to_bits();
    if bits >> 63 == 1 { !bits } else { bits | 1 << 63 }
}

impl LoaderSettings {
    /// As by default, with no more than an eighth of a memory budget waiting to be taken.
    pub fn within(budget: u64) -> LoaderSettings {
        let settings = LoaderSettings::default();
        LoaderSettings { finished_bytes_max: settings.finished_bytes_max.min(budget / 8), ..settings }
    }
}

impl Loader {
    /// Starts the threads.
    ///
    /// # Errors
    /// A system that gives no thread.
    pub fn new(world: Arc<World>, source: Arc<Source>, settings: LoaderSettings) -> std::io::Result<Loader> {
        let (state, work, done) = (Mutex::default(), Condvar::new(), Condvar::new());
        let shared = Arc::new(Shared { world, source, settings, state, work, done });
        let mut loader = Loader { shared, threads: Vec::new() };
        for number in 0..settings.workers.max(1) {
            let shared = loader.shared.clone();
            let thread = std::thread::Builder::new().name(format!("decode {number}")).spawn(move || shared.work())?;
            loader.threads.push(thread);
        }
        Ok(loader)
    }

    /// Contents that are decoded from now on are compressed so, by the threads that decode them.
    pub fn set_compression(&self, compression: Compression) {
        self.shared.lock().compression = compression;
    }

    /// Asks for a representation, of `rank`: what is larger comes first. One that is asked for already is ranked anew. Returns what was
    /// refused for lack of room: this one, or a less wanted one.
    pub fn ask(&self, rep: RepId, rank: f64, input: Input) -> Option<RepId> {
        let mut state = self.shared.lock();
        if let Some(wanted) = state.working.get_mut(&rep) {
            *wanted = true;
            return None;
        }
        let known = state.keys.remove(&rep);
        let input = known.and_then(|key| state.waiting.remove(&key)).map_or(input, |(_, input)| input);
        let key = Key(std::cmp::Reverse(ordered(rank)), state.next);
        state.next += 1;
        state.keys.insert(rep, key);
        state.waiting.insert(key, (rep, input));
        let refused = if state.waiting.len() > self.shared.settings.waiting_max.max(1) {
            state.waiting.pop_last().map(|(_, (rep, _))| rep)
        } else {
            None
        };
        if let Some(rep) = refused {
            state.keys.remove(&rep);
        }
        drop(state);
        self.shared.work.notify_one();
        refused
    }

    /// Ranks anew what waits.
    pub fn rank(&self, rep: RepId, rank: f64) {
        let mut state = self.shared.lock();
        let Some(key) = state.keys.get(&rep).copied() else { return };
        let Some(waiting) = state.waiting.remove(&key) else { return };
        let key = Key(std::cmp::Reverse(ordered(rank)), key.1);
        state.keys.insert(rep, key);
        state.waiting.insert(key, waiting);
    }

    /// Takes a request back: nothing will be heard of it, even if it is done already. False if there was none.
    pub fn cancel(&self, rep: RepId) -> bool {
        let mut state = self.shared.lock();
        if let Some(key) = state.keys.remove(&rep) {
            state.waiting.remove(&key);
            return true;
        }
        if let Some(wanted) = state.working.get_mut(&rep) {
            return std::mem::take(wanted);
        }
        let Some(at) = state.finished.iter().position(|loaded| loaded.rep == rep) else { return false };
        let loaded = state.finished.remove(at);
        state.finished_bytes = state.finished_bytes.saturating_sub(bytes_of(&loaded));
        drop(state);
        self.shared.work.notify_all();
        true
    }

    /// Whether a representation is asked for and not taken yet.
    pub fn is_asked(&self, rep: RepId) -> bool {
        let state = self.shared.lock();
        state.keys.contains_key(&rep)
            || state.working.get(&rep).copied().unwrap_or(false)
            || state.finished.iter().any(|loaded| loaded.rep == rep)
    }

    /// Takes what is done. Never waits.
    pub fn poll(&self) -> Vec<Loaded> {
        let mut state = self.shared.lock();
        state.finished_bytes = 0;
        let finished = std::mem::take(&mut state.finished);
        drop(state);
        self.shared.work.notify_all();
        finished
    }

    /// Takes what is done, and waits for something if nothing is; empty only if nothing is asked for.
    pub fn wait(&self) -> Vec<Loaded> {
        let mut state = self.shared.lock();
        while state.finished.is_empty() && !(state.waiting.is_empty() && state.working.is_empty()) {
            state = self.shared.done.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        drop(state);
        self.poll()
    }

    /// Requests that are not done.
    pub fn outstanding(&self) -> usize {
        let state = self.shared.lock();
        state.waiting.len() + state.working.values().filter(|wanted| **wanted).count()
    }

    /// Decoded bytes that wait to be taken.
    pub fn finished_bytes(&self) -> u64 {
        self.shared.lock().finished_bytes
    }
}

impl Drop for Loader {
    fn drop(&mut self) {
        self.shared.lock().is_over = true;
        self.shared.work.notify_all();
        for thread in self.threads.drain(..) {
            // A thread that panicked has nothing more to say.
            drop(thread.join());
        }
    }
}

fn bytes_of(loaded: &Loaded) -> u64 {
    let decoded = loaded.result.as_ref().map_or(0, |decoded| decoded.content.bytes());
    decoded + loaded.bytes.as_ref().map_or(0, |bytes| bytes.len() as u64)
}

impl Shared {
    /// No code that can panic runs while it is held.
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn work(&self) {
        while let Some((rep, input, compression)) = self.next() {
            let loaded = self.load(rep, input, compression);
            let mut state = self.lock();
            if state.working.remove(&rep).unwrap_or(false) {
                state.finished_bytes += bytes_of(&loaded);
                state.finished.push(loaded);
            }
            drop(state);
            self.done.notify_all();
        }
    }

    fn next(&self) -> Option<(RepId, Input, Compression)> {
        let mut state = self.lock();
        loop {
            if state.is_over {
                return None;
            }
            let has_room = state.finished.is_empty() || state.finished_bytes < self.settings.finished_bytes_max;
            if has_room && let Some((_, (rep, input))) = state.waiting.pop_first() {
                state.keys.remove(&rep);
                state.working.insert(rep, true);
                return Some((rep, input, state.compression));
            }
            state = self.work.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn load(&self, rep: RepId, input: Input, compression: Compression) -> Loaded {
        let (bytes, read) = match input {
            Input::Bytes(bytes) => (bytes, false),
            Input::Source => match self.source.bytes(&self.world, rep) {
                Ok(bytes) => (Bytes::from(bytes), true),
                Err(error) => return Loaded { rep, bytes: None, result: Err(error.to_string()) },
            },
        };
        // A fault of a decoder ends one content, not the program.
        let decoded = catch_unwind(AssertUnwindSafe(|| {
            let decoded = decode(&self.world, &self.source, rep, &bytes)?;
            Ok(Decoded { content: decoded.content.compressed(compression), ..decoded })
        }));
        let result = match decoded {
            Ok(result) => result.map_err(|error: DecodeError| error.to_string()),
            Err(_) => Err(format!("representation {} ({}): its decoder failed", rep.0, self.world.uri(rep))),
        };
        Loaded { rep, bytes: read.then_some(bytes), result }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::content::{Content, Texels};

    fn city() -> (Arc<World>, Arc<Source>) {
        let (world, source) = Source::open("city:blocks=1").expect("a city");
        (Arc::new(world), Arc::new(source))
    }

    #[test]
    fn everything_asked_for_comes_once_with_the_most_wanted_first() {
        let (world, source) = city();
        let settings = LoaderSettings { workers: 1, finished_bytes_max: 1, ..LoaderSettings::default() };
        let loader = Loader::new(world.clone(), source, settings).expect("a thread");
        let count = world.tree.representations() as u32;
        // Busy with the first, while the others come.
        for rep in (0..count).map(RepId) {
            assert_eq!(loader.ask(rep, f64::from(rep.0), Input::Source), None);
        }
        assert!(loader.cancel(RepId(1)) && !loader.cancel(RepId(count)));
        loader.rank(RepId(2), f64::INFINITY);
        let mut order = Vec::new();
        loop {
            let loaded = loader.wait();
            if loaded.is_empty() {
                break;
            }
            for loaded in loaded {
                assert!(loaded.result.is_ok() && loaded.bytes.is_some());
                order.push(loaded.rep.0);
            }
        }
        let mut sorted = order.clone();
        sorted.sort_unstable();
        sorted.dedup();
        assert_eq!(sorted.len(), order.len(), "each once");
        assert_eq!(order.len(), count as usize - 1);
        assert!(!order.contains(&1) && loader.outstanding() == 0);
        // Threads may have taken some before they were ranked; from there on ranks fall.
        let tail: Vec<u32> = order.iter().copied().filter(|&rep| rep != 2).skip(16).collect();
        assert!(tail.is_sorted_by(|a, b| a > b), "{order:?}");
    }

    #[test]
    fn contents_come_compressed_from_the_threads_that_decode_them() {
        let (world, source) = city();
        let loader = Loader::new(world.clone(), source.clone(), LoaderSettings::default()).expect("threads");
        let textures = |content: &Content| match content {
            Content::Mesh(mesh) => mesh.textures.clone(),
            _ => Vec::new(),
        };
        let mut compressed = 0;
        for compression in Compression::ALL {
            loader.set_compression(compression);
            for rep in (0..world.tree.representations() as u32).map(RepId) {
                loader.ask(rep, 0.0, Input::Source);
            }
            loop {
                let loaded = loader.wait();
                if loaded.is_empty() {
                    break;
                }
                for Loaded { rep, bytes, result } in loaded {
                    let bytes = bytes.expect("read there");
                    let found = textures(&result.expect("a content").content);
                    let plain = decode(&world, &source, rep, &bytes).expect("a content").content;
                    assert_eq!(found, textures(&plain.compressed(compression)), "{rep:?}, {compression:?}");
                    compressed += found.iter().filter(|texture| texture.kept != Texels::Plain).count();
                }
            }
        }
        assert!(compressed > 0);
    }

    #[test]
    fn faults_are_told_and_too_many_requests_refused() {
        let (world, source) = city();
        let settings = LoaderSettings { workers: 1, waiting_max: 2, finished_bytes_max: 1 };
        let loader = Loader::new(world, source, settings).expect("a thread");
        for input in [Input::Source, Input::Bytes(Bytes::from_static(b"glTF"))] {
            assert_eq!(loader.ask(RepId(1 << 30), 0.0, input), None);
            let loaded = loader.wait();
            let error = loaded[0].result.as_ref().expect_err("no such one");
            assert!(error.contains("representation 1073741824 (") && error.contains("expected"), "{error}");
        }
        let refused: Vec<RepId> =
            (0..40).filter_map(|rep| loader.ask(RepId(rep), -f64::from(rep), Input::Source)).collect();
        assert!(refused.len() >= 30 && !refused.contains(&RepId(0)), "{refused:?}");
    }

    #[test]
    fn ranks_keep_their_order() {
        let ranks = [f64::NAN, f64::NEG_INFINITY, -2.0, -1e-300, 0.0, 1e-300, 3.0, f64::INFINITY];
        assert!(ranks.map(ordered).is_sorted_by(|a, b| a < b));
    }
}
