//! Runs as rows of values, the same for both databases, and the checksum over them.

use super::RunStoreError;
use super::run::{FIGURES, Figure, Input, PolicyResult, Pressure, Run};
use crate::database::{Kind, Value};

/// Columns of `runs` that [`run_values`] gives, in its order.
pub(super) const RUN_COLUMNS: [(&str, Kind); 26] = [
    ("started_at_ms", Kind::Integer),
    ("program_version", Kind::Text),
    ("build", Kind::Text),
    ("suite_case", Kind::Text),
    ("folder", Kind::Text),
    ("arguments", Kind::Text),
    ("world", Kind::Text),
    ("world_hash", Kind::Text),
    ("path", Kind::Text),
    ("path_hash", Kind::Text),
    ("link", Kind::Text),
    ("link_hash", Kind::Text),
    ("settings", Kind::Text),
    ("seed", Kind::Text),
    ("inputs_hash", Kind::Text),
    ("result_hash", Kind::Text),
    ("wall_s", Kind::Real),
    ("peak_memory_bytes", Kind::Integer),
    ("nonempty_share", Kind::Real),
    ("lambda", Kind::Real),
    ("rho", Kind::Real),
    ("mu", Kind::Real),
    ("largest_need_bytes", Kind::Integer),
    ("bound_quality", Kind::Real),
    ("bound_method", Kind::Text),
    ("document_hash", Kind::Text),
];

/// The values of a run's own columns.
pub(super) fn run_values(run: &Run, document: &str) -> Result<Vec<Value>, RunStoreError> {
    let arguments = serde_json::Value::from(run.arguments.clone()).to_string();
    let values = vec![
        Value::Integer(Some(run.started_at_ms)),
        text(&run.program_version),
        text(&run.build),
        Value::Text(run.suite_case.clone()),
        Value::Text(run.folder.clone()),
        Value::Text(Some(arguments)),
        text(&run.world.name),
        text(&run.world.hash),
        text(&run.path.name),
        text(&run.path.hash),
        text(&run.link.name),
        text(&run.link.hash),
        text(&run.settings),
        Value::Text(Some(run.seed.to_string())),
        text(&run.inputs_hash),
        text(&run.result_hash),
        real(Some(run.wall_s)),
        integer("peak_memory_bytes", run.peak_memory_bytes)?,
        real(run.nonempty_share),
        real(run.pressure.lambda),
        real(run.pressure.rho),
        real(run.pressure.mu),
        integer("largest_need_bytes", Some(run.pressure.largest_need_bytes))?,
        real(run.bound_quality),
        text(&run.bound_method),
        Value::Text(Some(document_hash(document))),
    ];
    check(RUN_COLUMNS.iter().map(|(name, _)| *name), &values)?;
    if document.contains('\0') {
        return Err(RunStoreError::Value { column: "document", what: NUL });
    }
    Ok(values)
}

/// Columns of `results` after `run_id` and `place`, in the order of [`result_values`].
pub(super) fn result_columns() -> Vec<(String, Kind)> {
    let mut columns = vec![("policy".to_owned(), Kind::Text)];
    for figure in FIGURES {
        columns.extend(["", "_lower", "_upper"].map(|end| (format!("{figure}{end}"), Kind::Real)));
    }
    columns.push(("decisions".to_owned(), Kind::Real));
    columns.extend(["p50", "p99", "max"].map(|end| (format!("decision_ns_{end}"), Kind::Integer)));
    columns
}

/// The values of a result's columns.
pub(super) fn result_values(result: &PolicyResult) -> Result<Vec<Value>, RunStoreError> {
    let mut values = vec![text(&result.policy)];
    check(["policy"].into_iter(), &values)?;
    for (name, figure) in FIGURES.into_iter().zip(&result.figures) {
        let ends = [figure.value, figure.lower, figure.upper].map(real);
        check([name; 3].into_iter(), &ends)?;
        values.extend(ends);
    }
    values.push(real(result.decisions));
    for nanos in result.decision_ns {
        values.push(integer("decision_ns", Some(nanos))?);
    }
    check(["decisions"].into_iter(), &values[values.len() - 4..values.len() - 3])?;
    Ok(values)
}

/// The inverse of [`run_values`], and the document's hash; `None` where a value is not what was written.
pub(super) fn run_from(values: Vec<Value>) -> Option<(Run, String)> {
    let mut values = Values(values.into_iter());
    let run = Run {
        started_at_ms: values.integer()??,
        program_version: values.text()??,
        build: values.text()??,
        suite_case: values.text()?,
        folder: values.text()?,
        arguments: serde_json::from_str(&values.text()??).ok()?,
        world: values.input()?,
        path: values.input()?,
        link: values.input()?,
        settings: values.text()??,
        seed: values.text()??.parse().ok()?,
        inputs_hash: values.text()??,
        result_hash: values.text()??,
        wall_s: values.real()??,
        peak_memory_bytes: values.integer()?.map(u64::try_from).transpose().ok()?,
        nonempty_share: values.real()?,
        pressure: Pressure {
            lambda: values.real()?,
            rho: values.real()?,
            mu: values.real()?,
            largest_need_bytes: values.count()?,
        },
        bound_quality: values.real()?,
        bound_method: values.text()??,
        results: Vec::new(),
    };
    let document_hash = values.text()??;
    Some((run, document_hash))
}

/// The inverse of [`result_values`].
pub(super) fn result_from(values: Vec<Value>) -> Option<PolicyResult> {
    let mut values = Values(values.into_iter());
    let mut result = PolicyResult { policy: values.text()??, ..PolicyResult::default() };
    for figure in &mut result.figures {
        *figure = Figure { value: values.real()?, lower: values.real()?, upper: values.real()? };
    }
    result.decisions = values.real()?;
    for nanos in &mut result.decision_ns {
        *nanos = values.count()?;
    }
    Some(result)
}

/// BLAKE3 of a run's values and of all of its results', each with its type and length.
pub(super) fn checksum(run: &[Value], results: &[Vec<Value>]) -> String {
    let mut hasher = blake3::Hasher::new();
    let mut hash_row = |row: &[Value]| {
        hasher.update(&(row.len() as u64).to_le_bytes());
        for value in row {
            let bytes = match value {
                Value::Integer(value) => value.map(|v| v.to_le_bytes().to_vec()),
                Value::Real(value) => value.map(|v| v.to_le_bytes().to_vec()),
                Value::Text(value) => value.as_ref().map(|v| v.as_bytes().to_vec()),
            };
            hasher.update(&bytes.as_ref().map_or(u64::MAX, |b| b.len() as u64).to_le_bytes());
            hasher.update(bytes.as_deref().unwrap_or_default());
        }
    };
    hash_row(run);
    for row in results {
        hash_row(row);
    }
    hasher.finalize().to_hex().to_string()
}

/// BLAKE3 of the document's bytes.
pub(super) fn document_hash(document: &str) -> String {
    blake3::hash(document.as_bytes()).to_hex().to_string()
}

const NUL: &str = "it contains a NUL character; expected text without one";

/// Refuses what one of the databases would refuse or change.
fn check<'a>(
    columns: impl Iterator<Item = &'static str>,
    values: impl IntoIterator<Item = &'a Value>,
) -> Result<(), RunStoreError> {
    for (column, value) in columns.zip(values) {
        match value {
            Value::Real(Some(real)) if !real.is_finite() => {
                return Err(RunStoreError::Value {
                    column,
                    what: "it is not finite; expected a finite number or none",
                });
            }
            Value::Text(Some(text)) if text.contains('\0') => return Err(RunStoreError::Value { column, what: NUL }),
            _ => {}
        }
    }
    Ok(())
}

fn text(text: &str) -> Value {
    Value::Text(Some(text.to_owned()))
}

/// −0 becomes 0, as SQLite would make it.
fn real(value: Option<f64>) -> Value {
    Value::Real(value.map(|v| v + 0.0))
}

fn integer(column: &'static str, value: Option<u64>) -> Result<Value, RunStoreError> {
    let stored = value.map(i64::try_from).transpose();
    stored.map(Value::Integer).map_err(|_| RunStoreError::Value { column, what: "it is 2^63 or more; expected less" })
}

/// Values of a row, taken one by one by their type.
struct Values(std::vec::IntoIter<Value>);

impl Values {
    fn integer(&mut self) -> Option<Option<i64>> {
        if let Value::Integer(value) = self.0.next()? { Some(value) } else { None }
    }

    fn count(&mut self) -> Option<u64> {
        u64::try_from(self.integer()??).ok()
    }

    fn real(&mut self) -> Option<Option<f64>> {
        if let Value::Real(value) = self.0.next()? { Some(value) } else { None }
    }

    fn text(&mut self) -> Option<Option<String>> {
        if let Value::Text(value) = self.0.next()? { Some(value) } else { None }
    }

    fn input(&mut self) -> Option<Input> {
        Some(Input { name: self.text()??, hash: self.text()?? })
    }
}
