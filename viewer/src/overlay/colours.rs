//! False colours: contents tinted by their level, their age or their benefit.

/// What contents are tinted by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FalseColour {
    /// Nothing.
    #[default]
    Off,
    /// Depth of their node in the tree.
    Level,
    /// Seconds since they came.
    Age,
    /// Their share of the view's quality.
    Benefit,
}

/// Youngest and oldest that are told apart, seconds.
const AGES: [f64; 2] = [0.25, 64.0];
/// Least and largest share of the quality that are told apart.
const SHARES: [f64; 2] = [1e-4, 0.1];

/// From little to much: dark blue over green to yellow, each lighter than the one before, so that they can be told apart
/// without colours too.
const RAMP: [[u8; 3]; 6] =
    [[40, 50, 130], [50, 100, 160], [50, 150, 140], [90, 190, 90], [180, 220, 60], [255, 245, 100]];

/// Hues that neighbours in a tree can be told apart by.
const LEVELS: [[u8; 3]; 8] = [
    [230, 80, 70],
    [240, 150, 50],
    [235, 220, 80],
    [110, 200, 80],
    [60, 190, 190],
    [80, 130, 230],
    [150, 100, 220],
    [220, 110, 190],
];

impl FalseColour {
    /// All, in the order in which the key goes through them.
    pub const ALL: [FalseColour; 4] = [FalseColour::Off, FalseColour::Level, FalseColour::Age, FalseColour::Benefit];

    /// In words.
    pub fn name(self) -> &'static str {
        match self {
            FalseColour::Off => "own colours",
            FalseColour::Level => "level",
            FalseColour::Age => "age",
            FalseColour::Benefit => "benefit",
        }
    }

    /// The next.
    pub fn next(self) -> FalseColour {
        let place = FalseColour::ALL.iter().position(|&one| one == self).unwrap_or(0);
        FalseColour::ALL[(place + 1) % FalseColour::ALL.len()]
    }

    /// What its colours mean, from the first to the last.
    pub fn legend(self) -> Option<([String; 2], Vec<[u8; 3]>)> {
        match self {
            FalseColour::Off => None,
            FalseColour::Level => Some((["root".to_owned(), "8 levels below".to_owned()], LEVELS.to_vec())),
            FalseColour::Age => Some(([format!("{} s ago", AGES[1]), format!("{} s ago", AGES[0])], RAMP.to_vec())),
            FalseColour::Benefit => Some((
                [format!("{} % of the quality", 100.0 * SHARES[0]), format!("{} %", 100.0 * SHARES[1])],
                RAMP.to_vec(),
            )),
        }
    }
}

/// On the ramp at `u`, from 0 to 1.
fn ramp(u: f64) -> [u8; 3] {
    let place = if u.is_finite() { u.clamp(0.0, 1.0) } else { 0.0 } * (RAMP.len() - 1) as f64;
    let first = (place as usize).min(RAMP.len() - 2);
    let part = place - first as f64;
    let mix = |channel: usize| {
        let (a, b) = (f64::from(RAMP[first][channel]), f64::from(RAMP[first + 1][channel]));
        libm::round(a + (b - a) * part) as u8
    };
    [mix(0), mix(1), mix(2)]
}

/// Where a value lies between two, by its logarithm.
fn between([low, high]: [f64; 2], value: f64) -> f64 {
    libm::log(value.max(low) / low) / libm::log(high / low)
}

/// Of a node so many levels below the root.
pub fn of_level(level: usize) -> [u8; 3] {
    LEVELS[level % LEVELS.len()]
}

/// Of what came so many seconds ago: the younger, the lighter.
pub fn of_age(seconds: f64) -> [u8; 3] {
    ramp(1.0 - between(AGES, seconds))
}

/// Of what is worth such a share of the quality.
pub fn of_benefit(share: f64) -> [u8; 3] {
    ramp(between(SHARES, share))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lightness(colour: [u8; 3]) -> f64 {
        0.2126 * f64::from(colour[0]) + 0.7152 * f64::from(colour[1]) + 0.0722 * f64::from(colour[2])
    }

    #[test]
    fn ramps_end_where_the_legend_says_and_rise() {
        assert_eq!((of_age(0.0), of_age(0.25), of_age(1e9)), (RAMP[5], RAMP[5], RAMP[0]));
        assert_eq!((of_benefit(0.0), of_benefit(1.0), of_benefit(f64::NAN)), (RAMP[0], RAMP[5], RAMP[0]));
        let shades: Vec<f64> = (0..=100).map(|i| lightness(ramp(f64::from(i) / 100.0))).collect();
        assert!(shades.is_sorted_by(|a, b| a < b), "{shades:?}");
        assert_ne!(of_level(3), of_level(4));
        let round: Vec<_> = std::iter::successors(Some(FalseColour::Off), |one| Some(one.next())).take(5).collect();
        assert_eq!((round[3], round[4]), (FalseColour::Benefit, FalseColour::Off));
    }
}
