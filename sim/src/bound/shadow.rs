//! Shadow prices: what more link or memory would have bought, interval by interval.

use super::whole::{Bound, FRAMES_PER_SECOND};
use serde::Serialize;

/// Most intervals of a list.
const INTERVALS_MAX: usize = 600;
const BYTES_PER_MEGABIT: f64 = 125_000.0;
const BYTES_PER_MEBIBYTE: f64 = 1_048_576.0;

/// By how much the upper bound of the mean quality would rise, to first order, with a little more of something; means over
/// the starts. Right for small changes: a price falls as more is given. Where the bound's prices are not quite optimal the
/// true rise is at most a little less, because the bound with more is at most this.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ShadowPrices {
    /// Length of an interval, seconds: 1, or as much as bounds the lists.
    pub interval_s: f64,
    /// Mean quality per Mbit/s more in each interval.
    pub per_mbit_s: Vec<f64>,
    /// Mean quality per MiB of memory more in each interval.
    pub per_mib: Vec<f64>,
    /// Mean quality per Mbit/s more throughout.
    pub per_mbit_s_throughout: f64,
    /// Mean quality per MiB more throughout.
    pub per_mib_throughout: f64,
    /// Mean quality per 1 % more of what the link delivers.
    pub per_percent_of_link: f64,
    /// Mean quality per 1 % more memory.
    pub per_percent_of_memory: f64,
}

impl ShadowPrices {
    /// From the bounds of the starts; `delivered` holds the bytes that the link can bring between each frame and the one
    /// before, by start, and `budget` is the memory. `None` without bounds.
    pub fn new(starts: &[Bound], delivered: &[Vec<f64>], budget: u64) -> Option<ShadowPrices> {
        let frames = starts.iter().find(|s| s.by_frame.is_some())?.per_link_byte.len();
        let seconds = frames.div_ceil(FRAMES_PER_SECOND).div_ceil(INTERVALS_MAX).max(1);
        let length = seconds * FRAMES_PER_SECOND;
        let share = 1.0 / starts.len() as f64;
        let mean = |of: fn(&Bound) -> &Vec<f64>, frame: usize| {
            starts.iter().map(|start| of(start).get(frame).copied().unwrap_or(0.0)).sum::<f64>() * share
        };
        let link: Vec<f64> = (0..frames).map(|frame| mean(|s| &s.per_link_byte, frame)).collect();
        let memory: Vec<f64> = (0..frames).map(|frame| mean(|s| &s.per_memory_byte, frame)).collect();
        // One Mbit/s more brings so much between two frames.
        let between = BYTES_PER_MEGABIT / FRAMES_PER_SECOND as f64;
        let per_mbit_s: Vec<f64> = link.chunks(length).map(|c| c.iter().sum::<f64>() * between).collect();
        let per_mib: Vec<f64> = memory.chunks(length).map(|c| c.iter().sum::<f64>() * BYTES_PER_MEBIBYTE).collect();
        let worth = |(start, bytes): (&Bound, &Vec<f64>)| {
            start.per_link_byte.iter().zip(bytes).map(|(price, bytes)| price * bytes).sum::<f64>()
        };
        Some(ShadowPrices {
            interval_s: seconds as f64,
            per_mbit_s_throughout: per_mbit_s.iter().sum(),
            per_mib_throughout: per_mib.iter().sum(),
            per_percent_of_link: 0.01 * share * starts.iter().zip(delivered).map(worth).sum::<f64>(),
            per_percent_of_memory: 0.01 * budget as f64 * memory.iter().sum::<f64>(),
            per_mbit_s,
            per_mib,
        })
    }
}
