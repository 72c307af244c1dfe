//! What is wrong with a number that was given: its field, its value, and what was expected.

/// A number that has no meaning where it was given.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("{field} is {value}; expected {expected}")]
pub struct SettingError {
    /// The field's name in the code.
    pub field: &'static str,
    /// As given.
    pub value: f64,
    /// The range, in words, with its unit.
    pub expected: &'static str,
}

/// Refuses a value outside `low` to `high`, and NaN.
pub(crate) fn within(
    field: &'static str,
    value: f64,
    (low, high): (f64, f64),
    expected: &'static str,
) -> Result<(), SettingError> {
    if value >= low && value <= high { Ok(()) } else { Err(SettingError { field, value, expected }) }
}
