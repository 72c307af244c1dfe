//! Numbers as a client may say them: MessagePack carries NaN and infinities, and no message means them.

use serde::de::{Deserialize, Deserializer, Error};

fn finite<E: Error>(number: f64) -> Result<f64, E> {
    if number.is_finite() { Ok(number) } else { Err(E::custom(format_args!("{number}; expected a finite number"))) }
}

/// A finite number.
pub(crate) fn number<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    f64::deserialize(deserializer).and_then(finite)
}

/// An array of finite numbers.
pub(crate) fn numbers<'de, D: Deserializer<'de>, const N: usize>(deserializer: D) -> Result<[f64; N], D::Error>
where
    [f64; N]: Deserialize<'de>,
{
    let numbers = <[f64; N]>::deserialize(deserializer)?;
    numbers.iter().try_for_each(|&number| finite(number).map(drop))?;
    Ok(numbers)
}
