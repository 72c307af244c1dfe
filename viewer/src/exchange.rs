//! What whoever draws shares with whoever fetches: the camera one way, contents the other, and how things stand.
//!
//! Both sides look in when it suits them, and none waits for the other. Bodies that are not taken are within the memory
//! budget of whoever puts them there, who takes them back when they are let go.

use bytes::Bytes;
use foresight_scheduler::view::View;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// What is to be decoded and shown.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Body {
    /// As it came over the network.
    Bytes(Bytes),
    /// It is where the world is.
    Local,
}

/// A body to be shown, with the number under which it was given.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Given {
    /// Which representation.
    pub rep: u32,
    /// Tells this from what was given for the same before.
    pub number: u64,
    /// What of it.
    pub body: Body,
}

/// What became of a body.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Told {
    /// Which representation.
    pub rep: u32,
    /// As it was given.
    pub number: u64,
    /// What.
    pub fate: Fate,
}

/// What becomes of a body.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Fate {
    /// It can be seen.
    Shown,
    /// It cannot be shown: why.
    Broken(String),
    /// It was shown and is lost, with the device that had it.
    Lost,
}

/// Whether there is somebody who decides.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Link {
    /// The scheduler runs in this program.
    #[default]
    InProcess,
    /// A session of a server.
    Connected,
    /// The server is away; it is tried again.
    Away {
        /// Why.
        why: String,
    },
    /// There is none any more: why.
    Over(String),
}

/// Something on its way.
#[derive(Clone, Debug, PartialEq)]
pub struct Fetching {
    /// Which representation.
    pub rep: u32,
    /// Bytes on the wire.
    pub bytes: u64,
    /// Of these, what has come.
    pub received: u64,
    /// Why it was chosen, in words.
    pub why: String,
}

/// How things stand.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Status {
    /// Who decides.
    pub link: Link,
    /// Policy with its options.
    pub policy: String,
    /// Quality of the latest view that was judged; `None` where nothing is in view.
    pub quality: Option<f64>,
    /// Estimate of the link: bytes/s and seconds.
    pub estimate: Option<(f64, f64)>,
    /// Bytes received since the start.
    pub received: u64,
    /// Memory in use, bytes, wire form and what is under way included.
    pub memory: u64,
    /// Memory budget, bytes.
    pub budget: u64,
    /// On their way, in order of number.
    pub fetching: Vec<Fetching>,
    /// Why nothing is requested, where nothing is.
    pub waiting: Option<String>,
    /// Requests that failed.
    pub failed: u64,
    /// The latest failure.
    pub failure: Option<String>,
}

#[derive(Debug, Default)]
struct Inner {
    view: Option<View>,
    bodies: BTreeMap<u32, Given>,
    numbers: BTreeMap<u32, u64>,
    gone: BTreeSet<u32>,
    told: Vec<Told>,
    status: Status,
    next: u64,
    is_left: bool,
}

/// The exchange.
#[derive(Debug, Default)]
pub struct Exchange(Mutex<Inner>);

impl Exchange {
    /// Nothing yet.
    pub fn new() -> Exchange {
        Exchange::default()
    }

    /// No code that can panic runs while it is held.
    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whoever draws: the camera is here now.
    pub fn look(&self, view: View) {
        self.lock().view = Some(view);
    }

    /// Whoever fetches: where the camera is.
    pub fn view(&self) -> Option<View> {
        self.lock().view
    }

    /// Whoever fetches: this is to be shown.
    pub fn give(&self, rep: u32, body: Body) {
        let mut inner = self.lock();
        let number = inner.next;
        inner.next += 1;
        inner.bodies.insert(rep, Given { rep, number, body });
        inner.numbers.insert(rep, number);
    }

    /// Whoever fetches: this is to be forgotten.
    pub fn take_back(&self, rep: u32) {
        let mut inner = self.lock();
        if inner.numbers.remove(&rep).is_none() {
            return;
        }
        inner.bodies.remove(&rep);
        // It, or what was given for it before, may have been taken.
        inner.gone.insert(rep);
    }

    /// Whoever draws: what is to be forgotten, which comes first, and what is to be shown since the last call.
    pub fn take(&self) -> (BTreeSet<u32>, Vec<Given>) {
        let mut inner = self.lock();
        let gone = std::mem::take(&mut inner.gone);
        (gone, std::mem::take(&mut inner.bodies).into_values().collect())
    }

    /// Whoever draws: what became of a body. What was taken back meanwhile is not passed on.
    pub fn tell(&self, told: Told) {
        let mut inner = self.lock();
        if inner.numbers.get(&told.rep) == Some(&told.number) {
            inner.told.push(told);
        }
    }

    /// Whoever fetches: what became of bodies since the last call, in order.
    pub fn hear(&self) -> Vec<Told> {
        let mut inner = self.lock();
        let told = std::mem::take(&mut inner.told);
        told.into_iter().filter(|told| inner.numbers.get(&told.rep) == Some(&told.number)).collect()
    }

    /// Whoever fetches: how things stand.
    pub fn set_status(&self, status: Status) {
        self.lock().status = status;
    }

    /// Whoever draws: how things stand.
    pub fn status(&self) -> Status {
        self.lock().status.clone()
    }

    /// Whoever draws: it is over.
    pub fn leave(&self) {
        self.lock().is_left = true;
    }

    /// Whoever fetches: whether it is over.
    pub fn is_left(&self) -> bool {
        self.lock().is_left
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn body(text: &'static str) -> Body {
        Body::Bytes(Bytes::from_static(text.as_bytes()))
    }

    #[test]
    fn what_is_taken_back_is_forgotten_and_nothing_old_is_heard() {
        let exchange = Exchange::new();
        exchange.give(3, body("a"));
        exchange.give(4, body("b"));
        exchange.take_back(4);
        let (gone, given) = exchange.take();
        assert_eq!((gone.into_iter().collect::<Vec<_>>(), given.len()), (vec![4], 1));
        // Given anew before the first is shown: the first says nothing any more.
        let first = given[0].clone();
        exchange.take_back(3);
        exchange.give(3, body("c"));
        let tell = |number, fate| exchange.tell(Told { rep: 3, number, fate });
        tell(first.number, Fate::Shown);
        assert_eq!(exchange.hear(), []);
        let (gone, given) = exchange.take();
        assert!(gone.contains(&3) && given[0].body == body("c"));
        tell(given[0].number, Fate::Shown);
        exchange.take_back(3);
        assert_eq!(exchange.hear(), []);
        exchange.take_back(9);
        assert!(exchange.take().0.into_iter().eq([3]));
    }
}
