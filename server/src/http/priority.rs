//! Priorities of requests (RFC 9218), and the turns at the disk that they order.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use axum::http::{HeaderMap, HeaderValue};
use sfv::{BareItem, Dictionary, ListEntry, Parser};
use tokio::sync::oneshot;

/// Urgency 0 (first) to 7 (last), and whether a part of the response is already of use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Priority {
    /// 0 to 7.
    pub urgency: u8,
    /// A part is of use.
    pub incremental: bool,
}

impl Default for Priority {
    fn default() -> Priority {
        Priority { urgency: 3, incremental: false }
    }
}

impl Priority {
    /// Of a request.
    pub(super) fn of(headers: &HeaderMap) -> Priority {
        headers.get("priority").map_or_else(Priority::default, |value| Priority::parse(value.as_bytes()))
    }

    /// As a `Priority` field says; urgency 3, not incremental, where it says nothing or nothing valid.
    pub fn parse(field: &[u8]) -> Priority {
        let mut priority = Priority::default();
        let Ok(fields) = Parser::new(field).parse::<Dictionary>() else { return priority };
        let item = |key: &str| match fields.get(key) {
            Some(ListEntry::Item(item)) => Some(&item.bare_item),
            _ => None,
        };
        if let Some(BareItem::Integer(urgency)) = item("u")
            && let Ok(urgency @ 0..=7) = u8::try_from(i64::from(*urgency))
        {
            priority.urgency = urgency;
        }
        if let Some(BareItem::Boolean(incremental)) = item("i") {
            priority.incremental = *incremental;
        }
        priority
    }

    /// As a response says it.
    pub(super) fn header(self) -> HeaderValue {
        const PLAIN: [&str; 8] = ["u=0", "u=1", "u=2", "u=3", "u=4", "u=5", "u=6", "u=7"];
        const PARTS: [&str; 8] = ["u=0, i", "u=1, i", "u=2, i", "u=3, i", "u=4, i", "u=5, i", "u=6, i", "u=7, i"];
        HeaderValue::from_static((if self.incremental { PARTS } else { PLAIN })[usize::from(self.urgency & 7)])
    }
}

/// So many may read from the disk at a time. Others wait: the more urgent before the less; of equal urgency the response
/// that was begun first is read to its end, incremental ones block by block in turn.
#[derive(Debug)]
pub(super) struct Turns(Mutex<State>);

#[derive(Debug)]
struct State {
    free: usize,
    next: u64,
    waiting: BTreeMap<(u8, u64, u64), oneshot::Sender<Turn>>,
}

/// A place in the order of one response.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    priority: Priority,
    begun: u64,
}

impl Turns {
    pub(super) fn new(at_a_time: usize) -> Arc<Turns> {
        Arc::new(Turns(Mutex::new(State { free: at_a_time.max(1), next: 0, waiting: BTreeMap::new() })))
    }

    /// The place of a response that begins now.
    pub(super) fn place(&self, priority: Priority) -> Place {
        Place { priority, begun: self.lock().number() }
    }

    /// Waits for a turn, which lasts until it is dropped.
    pub(super) async fn turn(self: &Arc<Turns>, place: Place) -> Turn {
        let waiting = {
            let mut state = self.lock();
            if state.free > 0 {
                state.free -= 1;
                return Turn(self.clone());
            }
            let number = state.number();
            let begun = if place.priority.incremental { number } else { place.begun };
            let (sender, waiting) = oneshot::channel();
            state.waiting.insert((place.priority.urgency, begun, number), sender);
            waiting
        };
        match waiting.await {
            Ok(turn) => turn,
            // The sender lies in the queue until it sends; a turn more than there should be would do no harm.
            Err(_) => Turn(self.clone()),
        }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    fn number(&mut self) -> u64 {
        self.next += 1;
        self.next
    }
}

/// A turn at the disk.
#[derive(Debug)]
pub(super) struct Turn(Arc<Turns>);

impl Drop for Turn {
    fn drop(&mut self) {
        let next = {
            let mut state = self.0.lock();
            let next = state.waiting.pop_first();
            if next.is_none() {
                state.free += 1;
            }
            next
        };
        // If whoever waited is gone, the turn comes back here and goes to the one behind.
        if let Some((_, sender)) = next {
            drop(sender.send(Turn(self.0.clone())));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(text: &str) -> (u8, bool) {
        let priority = Priority::parse(text.as_bytes());
        (priority.urgency, priority.incremental)
    }

    #[test]
    fn fields_that_are_not_valid_count_as_absent() {
        for (text, priority) in [
            ("u=0, i", (0, true)),
            ("i, u=7", (7, true)),
            ("u=5;x=1, i=?0", (5, false)),
            ("u=8", (3, false)),
            ("u=-1", (3, false)),
            ("u=1.5, i=1", (3, false)),
            ("u=(1 2)", (3, false)),
            ("u=2, u=4", (4, false)),
            ("u=", (3, false)),
            ("", (3, false)),
            ("urgent", (3, false)),
        ] {
            assert_eq!(of(text), priority, "{text}");
        }
        assert_eq!(Priority { urgency: 2, incremental: true }.header(), "u=2, i");
    }

    #[tokio::test]
    async fn the_more_urgent_goes_first_and_those_who_left_are_passed_over() {
        let turns = Turns::new(1);
        let held = turns.turn(turns.place(Priority { urgency: 7, incremental: false })).await;
        let order = Arc::new(Mutex::new(Vec::new()));
        let mut tasks = Vec::new();
        for (name, urgency, incremental) in
            [("late", 5, false), ("first", 0, true), ("gone", 1, false), ("middle", 3, false), ("after", 3, true)]
        {
            let place = turns.place(Priority { urgency, incremental });
            let (turns, order) = (turns.clone(), order.clone());
            tasks.push((
                name,
                tokio::spawn(async move {
                    let _turn = turns.turn(place).await;
                    order.lock().unwrap().push(name);
                }),
            ));
            tokio::task::yield_now().await;
        }
        for (name, task) in &tasks {
            if *name == "gone" {
                task.abort();
            }
        }
        tokio::task::yield_now().await;
        drop(held);
        for (_, task) in tasks {
            let _ = task.await;
        }
        assert_eq!(*order.lock().unwrap(), ["first", "middle", "after", "late"]);
        assert_eq!(turns.lock().free, 1);
    }
}
