//! The simulated client's own work: decoding on a few workers, uploading within a budget per frame.

use foresight_scheduler::lod_tree::RepId;
use foresight_scheduler::units::Time;
use std::collections::VecDeque;

/// What the client can do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClientSettings {
    /// Decoded bytes per second and worker.
    pub decode_rate: f64,
    /// Decoding workers.
    pub decode_workers: usize,
    /// Decoded bytes uploaded per tick (1/60 s). What is larger takes several.
    pub upload_bytes_per_tick: u64,
    /// Once a second the client announces where its camera will be for so many seconds; 0 for a client that does not.
    pub announce_s: f64,
}

impl Default for ClientSettings {
    fn default() -> ClientSettings {
        ClientSettings { decode_rate: 200e6, decode_workers: 2, upload_bytes_per_tick: 8 << 20, announce_s: 0.0 }
    }
}

impl ClientSettings {
    /// A client for which decoding and uploading cost nothing, and which announces nothing.
    pub fn unlimited() -> ClientSettings {
        ClientSettings { decode_rate: f64::MAX, upload_bytes_per_tick: u64::MAX, ..ClientSettings::default() }
    }
}

#[derive(Clone, Copy, Debug)]
struct Decoding {
    rep: RepId,
    decoded_bytes: u64,
    /// When it can be uploaded.
    done: Time,
}

/// Representations between their last byte and their first frame, in order of arrival.
#[derive(Clone, Debug)]
pub struct Pipeline {
    settings: ClientSettings,
    /// When each worker is free.
    workers: Vec<Time>,
    /// In order of arrival.
    decoding: VecDeque<Decoding>,
    /// Bytes of the first that were uploaded in earlier ticks.
    uploaded: u64,
}

impl Pipeline {
    /// An idle client.
    pub fn new(settings: ClientSettings) -> Pipeline {
        let workers = vec![Time::ZERO; settings.decode_workers.max(1)];
        Pipeline { settings, workers, decoding: VecDeque::new(), uploaded: 0 }
    }

    /// The last byte of `rep`, of this size when decoded, came at `now`.
    pub fn arrived(&mut self, rep: RepId, decoded_bytes: u64, now: Time) {
        let work = Time::from_secs(decoded_bytes as f64 / self.settings.decode_rate);
        let mut first = 0;
        for (i, free) in self.workers.iter().enumerate() {
            if *free < self.workers[first] {
                first = i;
            }
        }
        let done = now.max(self.workers[first]) + work;
        self.workers[first] = done;
        self.decoding.push_back(Decoding { rep, decoded_bytes, done });
    }

    /// What has arrived and cannot be shown yet.
    pub fn waiting(&self) -> impl Iterator<Item = RepId> + '_ {
        self.decoding.iter().map(|d| d.rep)
    }

    /// Drops what can be shown no more; the time that it took or takes a worker stays spent. False if it is not here.
    pub fn give_up(&mut self, rep: RepId) -> bool {
        let Some(place) = self.decoding.iter().position(|d| d.rep == rep) else { return false };
        self.decoding.remove(place);
        if place == 0 {
            self.uploaded = 0;
        }
        true
    }

    /// Uploads within one tick's budget; `ready` says whether a representation's prerequisite can be shown already, and
    /// `shown` is told what can be shown from now on. Uploads are made in order of arrival among those that are ready.
    pub fn upload(&mut self, now: Time, ready: impl Fn(RepId) -> bool, mut shown: impl FnMut(RepId)) {
        let mut budget = self.settings.upload_bytes_per_tick;
        while let Some(place) = self.decoding.iter().position(|d| d.done <= now && ready(d.rep)) {
            let Decoding { rep, decoded_bytes, .. } = self.decoding[place];
            // A partial upload belongs to the one that was first; another only takes its place when it was not ready.
            let left = decoded_bytes.saturating_sub(if place == 0 { self.uploaded } else { 0 });
            if left > budget {
                if place == 0 {
                    self.uploaded += budget;
                    return;
                }
                // What exceeds a whole budget by itself must not wait for ever behind one that is not ready.
                if left <= self.settings.upload_bytes_per_tick {
                    return;
                }
            }
            budget = budget.saturating_sub(left);
            if place == 0 {
                self.uploaded = 0;
            }
            self.decoding.remove(place);
            shown(rep);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn workers_share_the_decoding_and_uploads_are_spread() {
        let settings = ClientSettings {
            decode_rate: 1000.0,
            decode_workers: 2,
            upload_bytes_per_tick: 1000,
            ..ClientSettings::default()
        };
        let mut pipeline = Pipeline::new(settings);
        for (rep, decoded_bytes) in [1000, 1000, 1000, 2500].into_iter().enumerate() {
            pipeline.arrived(RepId(rep as u32), decoded_bytes, Time::ZERO);
        }
        let mut seen = Vec::new();
        for second in 0..8 {
            let now = Time::from_secs(second as f64);
            pipeline.upload(now, |_| true, |rep| seen.push((second, rep.0)));
        }
        // Two decoded at 1 s, a third at 2 s, the fourth at 1 + 2.5 s; one upload's worth a tick.
        assert_eq!(seen, [(1, 0), (2, 1), (3, 2), (6, 3)]);
    }

    #[test]
    fn what_waits_for_its_prerequisite_lets_others_pass() {
        let mut pipeline = Pipeline::new(ClientSettings::default());
        pipeline.arrived(RepId(0), 10, Time::ZERO);
        pipeline.arrived(RepId(1), 10, Time::ZERO);
        let mut seen = Vec::new();
        pipeline.upload(Time::from_secs(1.0), |rep| rep != RepId(0), |rep| seen.push(rep));
        assert_eq!(seen, [RepId(1)]);
    }
}
