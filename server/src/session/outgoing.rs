//! Answers on their way to a connection: bounded, and what is superseded is left out.

use foresight_wire::message::{Error, ErrorCode, ServerMessage};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;
use tokio::sync::Notify;

/// Answers that wait for one connection.
#[derive(Debug)]
pub(super) struct Outgoing {
    state: Mutex<State>,
    changed: Notify,
    /// More wait than may.
    full: Notify,
    /// Messages that may wait before further ones come.
    most: usize,
}

#[derive(Debug, Default)]
struct State {
    messages: Vec<ServerMessage>,
    /// When the frames that these messages answer were received; no more than messages may wait.
    answered: Vec<Instant>,
    closed: Option<Closed>,
}

/// Why nothing more comes.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Closed {
    /// For the client, if it is to be told.
    pub(super) error: Option<Error>,
    /// For log and metrics.
    pub(super) reason: &'static str,
}

/// What waits.
#[derive(Debug)]
pub(super) struct Batch {
    /// To be sent as one frame, if there are any.
    pub(super) messages: Vec<ServerMessage>,
    /// When the frames that they answer were received.
    pub(super) answered: Vec<Instant>,
    /// Nothing comes after them.
    pub(super) closed: Option<Closed>,
}

impl Outgoing {
    pub(super) fn new(most: usize) -> Outgoing {
        Outgoing { state: Mutex::default(), changed: Notify::new(), full: Notify::new(), most }
    }

    /// Adds answers to a frame received then, or to none. False if the connection was closed, or is now because more waited
    /// already than may: then what waits is let go. The answers to one frame always fit.
    pub(super) fn push(&self, messages: Vec<ServerMessage>, received: Option<Instant>) -> bool {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        if state.closed.is_some() {
            return false;
        }
        if state.messages.len() > self.most {
            let message =
                format!("{} answers wait for this connection; expected at most {}", state.messages.len(), self.most);
            let error = Error { code: ErrorCode::Limit, message, fatal: true };
            self.full.notify_one();
            *state = State { closed: Some(Closed { error: Some(error), reason: "slow" }), ..State::default() };
            drop(state);
            self.changed.notify_one();
            return false;
        }
        for message in messages {
            let superseded = |old: &ServerMessage| match message {
                ServerMessage::Wait { .. } => matches!(old, ServerMessage::Wait { .. }),
                ServerMessage::Estimates(_) => matches!(old, ServerMessage::Estimates(_)),
                _ => false,
            };
            if matches!(message, ServerMessage::Wait { .. } | ServerMessage::Estimates(_)) {
                state.messages.retain(|old| !superseded(old));
            }
            state.messages.push(message);
        }
        if state.answered.len() < self.most {
            state.answered.extend(received);
        }
        drop(state);
        self.changed.notify_one();
        true
    }

    /// Ends it after what waits.
    pub(super) fn close(&self, reason: &'static str, error: Option<Error>) {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        state.closed.get_or_insert(Closed { error, reason });
        drop(state);
        self.changed.notify_one();
    }

    /// Waits until more wait than may.
    pub(super) async fn overflow(&self) {
        self.full.notified().await;
    }

    /// Waits for something to send. After [`Batch::closed`] there is nothing more.
    pub(super) async fn next(&self) -> Batch {
        loop {
            let changed = self.changed.notified();
            {
                let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
                if !state.messages.is_empty() || !state.answered.is_empty() || state.closed.is_some() {
                    let messages = std::mem::take(&mut state.messages);
                    let answered = std::mem::take(&mut state.answered);
                    return Batch { messages, answered, closed: state.closed.clone() };
                }
            }
            changed.await;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wait(until_ns: u64) -> ServerMessage {
        ServerMessage::Wait { until_ns, because: None }
    }

    #[tokio::test]
    async fn superseded_waits_are_left_out_and_order_is_kept() {
        let outgoing = Outgoing::new(16);
        assert!(outgoing.push(vec![ServerMessage::Cancel { rep: 1 }, wait(1)], None));
        assert!(outgoing.push(vec![ServerMessage::Discard { rep: 2 }, wait(2)], None));
        let batch = outgoing.next().await;
        assert_eq!(batch.messages, [ServerMessage::Cancel { rep: 1 }, ServerMessage::Discard { rep: 2 }, wait(2)]);
        assert!(batch.closed.is_none());
    }

    #[tokio::test]
    async fn too_many_close_it_with_a_reason() {
        let outgoing = Outgoing::new(16);
        for rep in 0..17 {
            assert!(outgoing.push(vec![ServerMessage::Cancel { rep }], None));
        }
        assert!(!outgoing.push(vec![ServerMessage::Cancel { rep: 17 }], None));
        assert!(!outgoing.push(vec![wait(1)], None));
        let batch = outgoing.next().await;
        assert!(batch.messages.is_empty());
        let closed = batch.closed.expect("closed");
        assert_eq!(closed.reason, "slow");
        assert_eq!(closed.error.map(|error| error.code), Some(ErrorCode::Limit));
    }
}
