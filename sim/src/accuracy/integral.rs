//! The added-benefit integral: every method and setting against the reference.

use super::outcome::{ErrorRow, GAIN_FLOOR, Kind, Splitting};
use super::record::{Answer, Record};
use super::reference::reference;
use super::scene::Scene;
use super::statistics::{relative_error, share};
use crate::stopwatch::Stopwatch;
use foresight_scheduler::estimate::Outcome;
use foresight_scheduler::integral::{AddedBenefit, IntegralError, Method, integrate};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Relative errors up to this are put down to rounding: no uncertified method is said to lie about less.
const ROUNDING: f64 = 1e-9;

/// Gains below this, sr·s, are enclosed as if they were this: 10⁻⁴ of a hundredth of a steradian for a second.
const ENCLOSURE_FLOOR: f64 = 1e-6;

/// The row over all scenes of a kind.
const ALL: &str = "all";

/// A method of the library, or the rule that the policy's samples amount to.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Rule {
    /// One sample in the middle of each leg, counted by the share of the leg after the arrival: the fixed grid.
    LegMiddle,
    /// A method of the library.
    Of(Method),
}

/// A rule at a setting.
#[derive(Clone, Debug)]
struct Tried {
    method: &'static str,
    setting: String,
    rule: Rule,
    certified: bool,
    is_fixed_grid: bool,
    is_split: bool,
}

/// Every method and setting, in the order of the rows.
fn tried() -> Vec<Tried> {
    let mut all = vec![Tried {
        method: "leg-middle",
        setting: "samples=1".to_owned(),
        rule: Rule::LegMiddle,
        certified: false,
        is_fixed_grid: true,
        is_split: false,
    }];
    let mut add = |method, setting: String, of: Method, certified, split: Option<bool>| {
        let (is_fixed_grid, is_split) = (split == Some(false), split == Some(true));
        all.push(Tried { method, setting, rule: Rule::Of(of), certified, is_fixed_grid, is_split });
    };
    for split in [false, true] {
        let name = |fixed, at_events| if split { at_events } else { fixed };
        let grids: &[u32] = if split { &[2, 8, 32] } else { &[2, 8, 32, 128, 2048] };
        for &intervals in grids {
            let method = Method::Trapezoid { intervals, split };
            add(name("trapezoid", "trapezoid, split"), format!("intervals={intervals}"), method, false, Some(split));
        }
        let panels: &[(u32, u32)] = if split {
            &[(2, 1), (3, 1), (4, 1), (8, 1), (8, 4)]
        } else {
            &[(1, 4), (4, 1), (4, 4), (8, 4), (8, 16), (8, 64), (8, 256)]
        };
        for &(nodes, panels) in panels {
            let method = Method::GaussLegendre { nodes, panels, split };
            let setting = format!("nodes={nodes} panels={panels}");
            add(name("gauss-legendre", "gauss-legendre, split"), setting, method, false, Some(split));
        }
    }
    for exponent in [2, 4, 6, 10] {
        let method = Method::GaussKronrod { tolerance: libm::pow(10.0, -f64::from(exponent)), evaluations_max: 3000 };
        add("gauss-kronrod", format!("tolerance=1e-{exponent}"), method, false, None);
    }
    add("closed-form", "–".to_owned(), Method::ClosedForm, false, None);
    for (exponent, evaluations_max) in [(1, 200), (2, 400), (3, 1000), (6, 4000)] {
        let tolerance = libm::pow(10.0, -f64::from(exponent));
        let method = Method::Enclosure { tolerance, floor: ENCLOSURE_FLOOR, evaluations_max };
        add("enclosure", format!("tolerance=1e-{exponent}"), method, true, None);
    }
    add("sampled", "–".to_owned(), Method::Sampled, false, Some(true));
    all
}

/// The sum over the legs of a candidate.
fn answer(rule: Rule, legs: &[AddedBenefit]) -> Result<Answer, IntegralError> {
    let mut sum = Answer::default();
    for benefit in legs {
        let (value, lower, upper, evaluations) = match rule {
            Rule::LegMiddle => {
                let (from, to) = (benefit.leg.from_s(), benefit.leg.to_s());
                let value = benefit.value(0.5 * (from + to)) * (to - benefit.from_s());
                (value, f64::NEG_INFINITY, f64::INFINITY, 1)
            }
            Rule::Of(method) => match integrate(benefit, &method)? {
                Outcome::Certified(c) => (c.value, c.lower, c.upper, c.evaluations),
                Outcome::Estimate(e) => {
                    (e.value, e.value - e.error_estimate, e.value + e.error_estimate, e.evaluations)
                }
            },
        };
        sum.value += value;
        sum.evaluations += u64::from(evaluations);
        // Sums of bounds are rounded outwards.
        sum.lower = (sum.lower + lower).next_down();
        sum.upper = (sum.upper + upper).next_up();
    }
    Ok(sum)
}

/// The truth about a candidate.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Truth {
    value: f64,
    /// How far the reference itself may be off.
    error: f64,
}

/// The sum over the legs, by the reference.
fn truth(legs: &[AddedBenefit]) -> Result<Truth, IntegralError> {
    let mut sum = Truth::default();
    for benefit in legs {
        let of_leg = reference(benefit)?;
        sum.value += of_leg.value;
        // The sum itself is rounded.
        sum.error += of_leg.error + f64::EPSILON * sum.value.abs();
    }
    Ok(sum)
}

/// Errors of every method and setting, scene by scene.
#[derive(Debug)]
pub struct Integrals {
    tried: Vec<Tried>,
    records: BTreeMap<(Kind, String, usize), Record>,
}

impl Default for Integrals {
    fn default() -> Integrals {
        Integrals { tried: tried(), records: BTreeMap::new() }
    }
}

impl Integrals {
    /// Sets every method against the reference on the candidates of `scene`.
    ///
    /// # Errors
    /// A candidate is not legal.
    pub fn measure(&mut self, scene: &Scene) -> Result<(), IntegralError> {
        let truths: Vec<Truth> =
            scene.candidates.par_iter().map(|legs| truth(legs)).collect::<Result<_, IntegralError>>()?;
        let best = truths.iter().map(|t| t.value.abs()).fold(0.0, f64::max);
        for (index, tried) in self.tried.iter().enumerate() {
            let count = scene.candidates.len().min(tried.at_most());
            let mut answers = Vec::with_capacity(count);
            let watch = Stopwatch::start();
            for legs in &scene.candidates[..count] {
                answers.push(answer(tried.rule, legs));
            }
            let nanos = watch.nanos();
            let mut record = Record::default();
            for (answer, truth) in answers.into_iter().zip(&truths) {
                match answer {
                    Ok(answer) => enter(&mut record, tried, &answer, truth, best),
                    Err(IntegralError::NoClosedForm(_)) => {}
                    Err(error) => return Err(error),
                }
            }
            // What has no closed form is refused in no time: the rest took all of it.
            record.nanos = nanos;
            self.records.entry((scene.kind, scene.case.clone(), index)).or_default().merge(&record);
        }
        Ok(())
    }

    /// A row a case, method and setting, and over all cases of a kind a row a method and setting, in that order.
    pub fn rows(&self) -> Vec<ErrorRow> {
        let mut whole: BTreeMap<(Kind, usize), Record> = BTreeMap::new();
        for ((kind, _, index), record) in &self.records {
            whole.entry((*kind, *index)).or_default().merge(record);
        }
        let single = self.records.iter().map(|((kind, case, index), record)| self.row(case, *kind, *index, record));
        let all = whole.iter().map(|((kind, index), record)| self.row(ALL, *kind, *index, record));
        single.chain(all).flatten().collect()
    }

    fn row(&self, case: &str, kind: Kind, index: usize, record: &Record) -> Option<ErrorRow> {
        let tried = &self.tried[index];
        Some(ErrorRow {
            method: tried.method.to_owned(),
            setting: tried.setting.clone(),
            certified: tried.certified,
            default: tried.rule == Rule::Of(Method::default()),
            ..record.row(case, kind)?
        })
    }

    /// Event splitting against the fixed grid on the real candidates: the split rule that reaches an error of 10⁻³ at the
    /// 99.9th percentile with the fewest evaluations, or the most accurate one, against the cheapest grid that is as good.
    pub fn splitting(&self) -> Option<Splitting> {
        let rows = self.rows();
        let of = |wanted: fn(&Tried) -> bool| -> Vec<&ErrorRow> {
            let is_wanted = |row: &&ErrorRow| {
                let tried = self.tried.iter().find(|t| t.method == row.method && t.setting == row.setting);
                row.case == ALL && row.kind == Kind::Real && tried.is_some_and(wanted)
            };
            rows.iter().filter(is_wanted).collect()
        };
        let (split, fixed) = (of(|t| t.is_split), of(|t| t.is_fixed_grid));
        let cheapest = |rows: &[&ErrorRow], is_good: &dyn Fn(&ErrorRow) -> bool| -> Option<ErrorRow> {
            let good = rows.iter().filter(|r| is_good(r));
            good.min_by(|a, b| a.evaluations.total_cmp(&b.evaluations)).map(|r| (*r).clone())
        };
        let most_accurate = |rows: &[&ErrorRow]| -> Option<ErrorRow> {
            rows.iter().min_by(|a, b| a.p999_relative_error.total_cmp(&b.p999_relative_error)).map(|r| (*r).clone())
        };
        let s = cheapest(&split, &|r| r.p999_relative_error <= SPLIT_ERROR).or_else(|| most_accurate(&split))?;
        let as_good = cheapest(&fixed, &|r| r.p999_relative_error <= s.p999_relative_error);
        let reached = as_good.is_some();
        let f = as_good.or_else(|| most_accurate(&fixed))?;
        let at_median = cheapest(&fixed, &|r| r.median_relative_error <= s.median_relative_error)
            .or_else(|| most_accurate(&fixed))?;
        let named = |r: &ErrorRow| format!("{} {}", r.method, r.setting);
        Some(Splitting {
            p999_relative_error: s.p999_relative_error,
            split: named(&s),
            split_evaluations: s.evaluations,
            fixed: named(&f),
            fixed_evaluations: f.evaluations,
            reached,
            ratio: f.evaluations / s.evaluations,
            ratio_at_median: at_median.evaluations / s.evaluations,
        })
    }
}

/// Error at which splitting is set against the fixed grid, if it is reached.
const SPLIT_ERROR: f64 = 1e-3;

/// Enters an answer of `tried` into `record`.
fn enter(record: &mut Record, tried: &Tried, answer: &Answer, truth: &Truth, best: f64) {
    record.errors.push(relative_error(answer.value, truth.value, best));
    record.evaluations += answer.evaluations;
    let width = answer.upper - answer.lower;
    if width.is_finite() {
        record.gaps.push(share(width, truth.value, best));
    }
    // Uncertified values are forgiven rounding, proven bounds are not.
    let forgiven = ROUNDING * truth.value.abs().max(GAIN_FLOOR * best) + f64::MIN_POSITIVE;
    let slack = truth.error + if tried.certified { 0.0 } else { forgiven };
    record.violations += u64::from(!answer.meets(truth.value - slack, truth.value + slack));
}

impl Tried {
    /// Candidates of a scene that it is tried on: fine grids on fewer. Proofs are tried on all.
    fn at_most(&self) -> usize {
        const EVALUATIONS: u32 = 1 << 19;
        let per_leg = match self.rule {
            Rule::Of(Method::Trapezoid { intervals, .. }) => intervals,
            Rule::Of(Method::GaussLegendre { nodes, panels, .. }) => nodes * panels,
            _ => 1,
        };
        if self.certified || per_leg < 64 { usize::MAX } else { (EVALUATIONS / (4 * per_leg)) as usize }
    }
}
