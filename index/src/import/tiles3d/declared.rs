//! The members of a tile as JSON has them, and the checks that turn them into what they mean.

use glam::{DMat3, DMat4, DVec3};
use serde::Deserialize;

use super::document::{Content, ImplicitTiling};
use super::volume::Volume;

/// Extensions of 3D Tiles 1.0 that 3D Tiles 1.1 took up, and those that say nothing about sizes or places.
pub(super) const KNOWN_EXTENSIONS: [&str; 4] =
    ["3DTILES_content_gltf", "3DTILES_implicit_tiling", "3DTILES_metadata", "3DTILES_multiple_contents"];

#[derive(Deserialize)]
pub(super) struct Asset {
    pub(super) version: String,
    #[serde(rename = "gltfUpAxis")]
    pub(super) gltf_up_axis: Option<String>,
    /// Not in the standard, but in use.
    pub(super) copyright: Option<serde_json::Value>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct VolumeJson {
    pub(super) r#box: Option<Vec<f64>>,
    pub(super) region: Option<Vec<f64>>,
    pub(super) sphere: Option<Vec<f64>>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct ContentJson {
    pub(super) uri: Option<String>,
    pub(super) url: Option<String>,
    pub(super) bounding_volume: Option<VolumeJson>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct ImplicitJson {
    pub(super) subdivision_scheme: String,
    pub(super) subtree_levels: u32,
    pub(super) available_levels: Option<u32>,
    /// Of the extension: one less.
    pub(super) maximum_level: Option<u32>,
    pub(super) subtrees: SubtreesJson,
}

#[derive(Deserialize)]
pub(super) struct SubtreesJson {
    pub(super) uri: String,
}

#[derive(Deserialize)]
pub(super) struct ExtensionsJson {
    #[serde(rename = "3DTILES_implicit_tiling")]
    pub(super) implicit: Option<ImplicitJson>,
    #[serde(rename = "3DTILES_multiple_contents")]
    pub(super) contents: Option<MultipleContentsJson>,
}

#[derive(Deserialize)]
pub(super) struct MultipleContentsJson {
    #[serde(alias = "content")]
    pub(super) contents: Vec<ContentJson>,
}

pub(super) fn volume(given: &VolumeJson) -> Result<Volume, String> {
    let numbers = |name: &str, values: &[f64], count: usize| {
        if values.len() == count && values.iter().all(|value| value.is_finite()) {
            return Ok(());
        }
        Err(format!("{name} with {} numbers; expected {count}, all finite", values.len()))
    };
    if let Some(values) = &given.r#box {
        numbers("box", values, 12)?;
        let column = |at: usize| DVec3::from_slice(&values[at..at + 3]);
        return Ok(Volume::Box { centre: column(0), half_axes: DMat3::from_cols(column(3), column(6), column(9)) });
    }
    if let Some(values) = &given.region {
        numbers("region", values, 6)?;
        let [_, south, _, north, low, high] = [values[0], values[1], values[2], values[3], values[4], values[5]];
        let quarter = core::f64::consts::FRAC_PI_2 + 1e-9;
        if !(-quarter <= south && south <= north && north <= quarter && low <= high) {
            return Err(format!("region {values:?}; expected −π/2 ≤ south ≤ north ≤ π/2 and heights in order"));
        }
        if values[0].abs() > 7.0 || values[2].abs() > 7.0 {
            return Err(format!("region {values:?}; expected longitudes in radians"));
        }
        return Ok(Volume::Region([values[0], south, values[2], north, low, high]));
    }
    if let Some(values) = &given.sphere {
        numbers("sphere", values, 4)?;
        if values[3] < 0.0 {
            return Err(format!("sphere with the radius {}; expected one that is not negative", values[3]));
        }
        return Ok(Volume::Sphere { centre: DVec3::from_slice(&values[..3]), radius: values[3] });
    }
    Err("neither \"box\", \"region\" nor \"sphere\"; expected one of them".to_owned())
}

pub(super) fn transform(values: &[f64]) -> Result<DMat4, String> {
    let values: &[f64; 16] =
        values.try_into().map_err(|_| format!("{} numbers; expected 16, column by column", values.len()))?;
    if let Some(bad) = values.iter().find(|value| !value.is_finite()) {
        return Err(format!("{bad}; expected finite numbers"));
    }
    let matrix = DMat4::from_cols_array(values);
    if (matrix.row(3) - glam::DVec4::W).abs().max_element() > 1e-9 {
        return Err(format!("last row {}; expected an affine transform, [0, 0, 0, 1]", matrix.row(3)));
    }
    Ok(matrix)
}

pub(super) fn content(given: ContentJson) -> Result<Content, String> {
    let uri = given.uri.or(given.url).ok_or("no member \"uri\"; expected the content's address")?;
    let volume = given.bounding_volume.as_ref().map(volume).transpose()?;
    Ok(Content { uri, volume })
}

pub(super) fn implicit(given: ImplicitJson) -> Result<ImplicitTiling, String> {
    let branching = match given.subdivision_scheme.as_str() {
        "QUADTREE" => 4,
        "OCTREE" => 8,
        other => return Err(format!("subdivisionScheme {other:?}; expected \"QUADTREE\" or \"OCTREE\"")),
    };
    let most = if branching == 4 { 12 } else { 8 };
    if !(1..=most).contains(&given.subtree_levels) {
        return Err(format!("subtreeLevels {}; expected 1 to {most}", given.subtree_levels));
    }
    let levels = given.available_levels.or(given.maximum_level.map(|level| level.saturating_add(1)));
    let available_levels = levels.ok_or("no member \"availableLevels\"; expected 1 to 30")?;
    if !(1..=30).contains(&available_levels) {
        return Err(format!("availableLevels {available_levels}; expected 1 to 30"));
    }
    Ok(ImplicitTiling {
        branching,
        subtree_levels: given.subtree_levels,
        available_levels,
        subtrees: given.subtrees.uri,
    })
}
