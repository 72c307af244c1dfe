//! The prices of the dual over time.

/// Prices at which nothing is worth more than it costs. Whatever they are, they prove a bound.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Prices {
    /// Λ_t = Σ_{s≥t} λ_s ≥ 0: mean quality per byte that comes in step t; not increasing.
    pub capacity: Vec<f64>,
    /// μ_t ≥ 0: mean quality per byte kept from the step before; the first is not used.
    pub memory: Vec<f64>,
    /// v ∈ [0, 1] of each target: accuracy that it has to pay for.
    pub shown: Vec<f32>,
    /// θ_t ∈ [0, 1]: to what part a step is bounded by its own frames.
    pub frame: Vec<f64>,
}

impl Prices {
    /// No capacity is worth anything, and every target pays `shown`.
    pub fn free(steps: usize, shown: Vec<f32>) -> Prices {
        Prices { capacity: vec![0.0; steps], memory: vec![0.0; steps], shown, frame: vec![0.0; steps] }
    }
}

/// Replaces `values` by the nearest that do not increase and are at least 0, in the metric of the positive `weights`:
/// neighbours that would increase share their weighted mean.
pub(super) fn decrease(values: &mut [f64], weights: &[f64]) {
    // Blocks as (mean, weight, end).
    let mut blocks: Vec<(f64, f64, usize)> = Vec::new();
    for (i, (&value, &weight)) in values.iter().zip(weights).enumerate() {
        let mut block = (value, weight, i + 1);
        while let Some(&(mean, before, _)) = blocks.last().filter(|b| b.0 < block.0) {
            blocks.pop();
            let sum = before + block.1;
            block = ((mean * before + block.0 * block.1) / sum, sum, block.2);
        }
        blocks.push(block);
    }
    let mut from = 0;
    for (mean, _, to) in blocks {
        values[from..to].fill(mean.max(0.0));
        from = to;
    }
}
