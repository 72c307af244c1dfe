//! Depths as what a predictor leaves of them, losslessly: small numbers where surfaces are even.
//!
//! The guess for a pixel with left, lower and lower left neighbours a, b and c is a + b − c kept between a and b (LOCO-I,
//! ISO/IEC 14495-1); in the first row a, in the first column b, at first 0. What is left, e, is coded as 2e for e ≥ 0 and
//! −2e − 1 otherwise.

/// Codes of depths of 10 bits, row by row, upwards: 11 bits each.
pub fn predicted(depths: &[u16], width: usize) -> Vec<u16> {
    let code = |at: usize| {
        let left = i32::from(depths[at]) - guess(depths, at, width);
        ((left << 1) ^ (left >> 31)) as u16
    };
    (0..depths.len()).map(code).collect()
}

/// The depths of codes; codes that no depths have give some depths of 10 bits.
pub fn restored(codes: &[u16], width: usize) -> Vec<u16> {
    let mut depths = Vec::with_capacity(codes.len());
    for (at, &code) in codes.iter().enumerate() {
        let code = i32::from(code);
        let left = (code >> 1) ^ -(code & 1);
        depths.push((guess(&depths, at, width) + left).clamp(0, 1023) as u16);
    }
    depths
}

/// The guess for a pixel by those before it.
fn guess(depths: &[u16], at: usize, width: usize) -> i32 {
    let width = width.max(1);
    let before = |back: usize| i32::from(depths[at - back]);
    match (at.is_multiple_of(width), at < width) {
        (false, false) => {
            let (a, b, c) = (before(1), before(width), before(width + 1));
            (a + b - c).clamp(a.min(b), a.max(b))
        }
        (false, true) => before(1),
        (true, false) => before(width),
        (true, true) => 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn depths_return(depths in prop::collection::vec(0..1024u16, 0..200), width in 1..20usize) {
            let codes = predicted(&depths, width);
            prop_assert!(codes.iter().all(|code| *code < 1 << 11));
            prop_assert_eq!(restored(&codes, width), depths);
        }

        #[test]
        fn any_codes_give_depths(codes in prop::collection::vec(0..=u16::MAX, 0..200), width in 0..20usize) {
            prop_assert!(restored(&codes, width).iter().all(|depth| *depth < 1024));
        }
    }

    #[test]
    fn planes_leave_nothing() {
        let depths: Vec<u16> = (0..64).map(|i| 100 + 3 * (i % 8) + 5 * (i / 8)).collect();
        let codes = predicted(&depths, 8);
        // Rising along both: a + b − c is beyond a and b, so that the larger is taken.
        assert!(codes.iter().skip(1).all(|code| *code <= 10), "{codes:?}");
        let level = [512u16; 64];
        assert!(predicted(&level, 8)[1..].iter().all(|code| *code == 0));
    }
}
