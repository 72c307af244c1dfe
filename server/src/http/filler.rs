//! Content of worlds that have none: pseudo-random bytes of the declared length, the same at every request, so that
//! links can be measured on worlds of any size.

use bytes::{Bytes, BytesMut};
use foresight_scheduler::lod_tree::RepId;
use foresight_traces::random::SplitMix64;

/// What the generator's state grows by at each number.
const STEP: u64 = 0x9e37_79b9_7f4a_7c15;

/// Bytes `from..to` of a representation's content: the little-endian numbers of [`SplitMix64`], seeded with the id shifted
/// left by 32.
pub(super) fn bytes(rep: RepId, from: u64, to: u64) -> Bytes {
    let mut out = BytesMut::with_capacity(usize::try_from(to.saturating_sub(from)).unwrap_or(0) + 16);
    let first = from / 8;
    let mut numbers = SplitMix64::new((u64::from(rep.0) << 32).wrapping_add(first.wrapping_mul(STEP)));
    for _ in first..to.div_ceil(8) {
        out.extend_from_slice(&numbers.bits().to_le_bytes());
    }
    let skipped = (from - first * 8) as usize;
    let mut out = out.freeze();
    out.truncate((to.max(from) - first * 8) as usize);
    out.slice(skipped.min(out.len())..)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_agree_with_the_whole() {
        let whole = bytes(RepId(7), 0, 1000);
        assert_eq!(whole.len(), 1000);
        assert_ne!(whole, bytes(RepId(8), 0, 1000));
        for (from, to) in [(0, 0), (0, 1), (3, 17), (8, 16), (991, 1000), (1000, 1000)] {
            assert_eq!(bytes(RepId(7), from, to), whole.slice(from as usize..to as usize), "{from}..{to}");
        }
    }
}
