//! What only concerns a client that draws nothing: modelled decoding, load, logs.

use super::seconds;
use clap::Args;
use foresight_viewer::crowd::CrowdSettings;
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
#[command(next_help_heading = "With --no-draw")]
pub(crate) struct NoDrawArgs {
    /// What the server's answers are for: drive (they are obeyed), warm (for clients with rules of their own), shadow
    /// (made and recorded, not sent)
    #[arg(long, default_value = "drive", value_name = "MODE", requires = "no_draw")]
    pub(crate) mode: ModeWord,
    /// Decoded bytes per second that each of two workers decodes
    #[arg(long, default_value_t = 200e6, value_name = "BYTES/S", requires = "no_draw")]
    pub(crate) decode_rate: f64,
    /// Decoded bytes uploaded per 1/60 s
    #[arg(long, default_value_t = 8 << 20, value_name = "BYTES", requires = "no_draw")]
    pub(crate) upload_budget: u64,
    /// Write what happens to each representation into this file, JSON lines
    #[arg(long, value_name = "FILE", conflicts_with = "clients", requires = "no_draw")]
    events: Option<PathBuf>,
    /// So many independent sessions at seeded places of the path, which they fly round and round
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=100_000), requires = "no_draw")]
    clients: Option<u64>,
    /// With --clients: sessions end after so many seconds in the mean, one in four without a word, and others come
    #[arg(long, value_name = "SECONDS", value_parser = seconds, requires = "clients")]
    stay: Option<f64>,
    /// With --clients: answers in the first so many seconds are not timed
    #[arg(long, default_value_t = 0.0, value_name = "SECONDS", value_parser = seconds, requires = "clients")]
    warm_up: f64,
    /// With --clients: seed of the places and of the lengths
    #[arg(long, default_value_t = 1, requires = "clients")]
    seed: u64,
    /// Fetch nothing: each session's requests are carried by a modelled link of its own, --link
    #[arg(long, requires = "no_draw")]
    pub(crate) no_fetch: bool,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
pub(crate) enum ModeWord {
    Drive,
    Warm,
    Shadow,
}

impl NoDrawArgs {
    /// Where what happens is written.
    pub(crate) fn events(&self) -> Option<&Path> {
        self.events.as_deref()
    }

    /// How many fly for `duration_s` at once, if more than one does.
    pub(crate) fn crowd(&self, duration_s: f64) -> Option<CrowdSettings> {
        Some(CrowdSettings {
            clients: self.clients?,
            duration_s,
            stay_s: self.stay.filter(|&stay| stay > 0.0),
            warm_up_s: self.warm_up,
            seed: self.seed,
        })
    }
}
