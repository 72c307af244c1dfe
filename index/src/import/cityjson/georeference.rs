//! Where a file's coordinates lie: its reference system, and whether its transform puts its vertices where it says.

use foresight_scheduler::lod_tree::Aabb;
use glam::DVec3;
use serde_json::Value;

use super::document::Transform;
use crate::geodesy::Projection;
use crate::world::{Georeference, Note, Severity};

/// The EPSG code in a reference system: `https://www.opengis.net/def/crs/EPSG/0/7415`, `urn:ogc:def:crs:EPSG::7415`,
/// `EPSG:7415`, or the first of a compound of such.
fn epsg_code(text: &str) -> Option<u32> {
    let (_, rest) = text.split_once("EPSG").or_else(|| text.split_once("epsg"))?;
    let rest = rest.strip_prefix([':', '/'])?;
    // Authority, version (may be empty), code; the short form has no version.
    let mut parts = rest.split([':', '/', ',', '&', '+']);
    let number = |part: Option<&str>| part.and_then(|part| part.trim().parse::<u32>().ok());
    let (first, second) = (parts.next(), parts.next());
    if rest.starts_with("0/") || first.is_some_and(|first| first.is_empty() || first.contains('.')) {
        number(second)
    } else {
        number(first)
    }
}

/// The horizontal part of a compound system, for those that city models come in; any other code as it is.
fn horizontal(code: u32) -> u32 {
    match code {
        5554..=5556 => code - 5554 + 25831,
        5698 => 2154,
        5971..=5976 => code - 5971 + 25831,
        6171..=6176 => code - 6171 + 25831,
        6190 => 31370,
        7405 => 27700,
        7415 => 28992,
        7416 | 7417 => code - 7416 + 25832,
        8370 => 3812,
        9897 => 2169,
        10162..=10174 => code - 10162 + 6669,
        _ => code,
    }
}

fn note(severity: Severity, file: &str, place: &str, text: String) -> Note {
    Note { severity, file: file.to_owned(), place: place.to_owned(), text }
}

/// What the metadata say of the coordinates: the georeference if the system is known, and if each corner of the bounds
/// is a place on the Earth in it.
pub(super) fn georeference(
    metadata: Option<&Value>,
    bounds: Aabb,
    file: &str,
    notes: &mut Vec<Note>,
) -> Option<Georeference> {
    const PLACE: &str = "$.metadata.referenceSystem";
    let system = metadata.and_then(|metadata| metadata.get("referenceSystem")).and_then(Value::as_str);
    // As it was written before 1.0.
    let crs = metadata.and_then(|metadata| metadata.get("crs")?.get("epsg")?.as_u64());
    let code = match (system, crs) {
        (Some(system), _) => epsg_code(system),
        (None, Some(code)) => u32::try_from(code).ok(),
        (None, None) => {
            let text = "no reference system: where on the Earth it lies is not known".to_owned();
            notes.push(note(Severity::Missing, file, PLACE, text));
            return None;
        }
    };
    let Some(code) = code.map(horizontal) else {
        let text = format!("{:?}; expected the address of an EPSG code: not georeferenced", system.unwrap_or_default());
        notes.push(note(Severity::Trap, file, PLACE, text));
        return None;
    };
    let projection = match Projection::from_epsg(code) {
        Ok(projection) => projection,
        Err(error) => {
            notes.push(note(Severity::Trap, file, PLACE, format!("{error}: not georeferenced")));
            return None;
        }
    };
    let (low, high) = (bounds.min, bounds.max);
    for (x, y) in [(low.x, low.y), (high.x, low.y), (low.x, high.y), (high.x, high.y)] {
        if let Err(error) = projection.inverse(DVec3::new(x, y, low.z)) {
            let text = format!("the objects are not on the Earth ({error}): not georeferenced");
            notes.push(note(Severity::Trap, file, PLACE, text));
            return None;
        }
    }
    Some(Georeference::Epsg(code))
}

/// How vertices become metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Placement {
    scale: DVec3,
    translate: DVec3,
}

impl Placement {
    /// As the file says; without a transform, vertices are metres.
    fn declared(transform: Option<Transform>) -> Placement {
        let scale = transform.map_or(DVec3::ONE, |transform| DVec3::from_array(transform.scale));
        Placement { scale, translate: transform.map_or(DVec3::ZERO, |t| DVec3::from_array(t.translate)) }
    }

    /// World coordinates, metres.
    pub(super) fn apply(self, vertex: [f64; 3]) -> DVec3 {
        DVec3::from_array(vertex) * self.scale + self.translate
    }

    fn bounds(self, raw: Aabb) -> Aabb {
        let (a, b) = (self.apply(raw.min.to_array()), self.apply(raw.max.to_array()));
        Aabb { min: a.min(b), max: a.max(b) }
    }
}

/// Declared extents that a file's objects leave by less than this share of their size are taken as right.
const TOLERANCE: f64 = 0.01;
/// A repair must fill this share of the declared extent in x and in y to be taken as proven.
const FILLED: f64 = 0.25;

/// Chooses how the vertices, whose raw coordinates `raw` bounds, become metres: as the transform says, unless the objects
/// then lie wholly outside of the file's own `geographicalExtent`, and without the transform's translation, or without the
/// transform, wholly inside and filling at least a quarter of it each way. Then the vertices were transformed already.
pub(super) fn placement(
    transform: Option<Transform>,
    metadata: Option<&Value>,
    raw: Aabb,
    file: &str,
    notes: &mut Vec<Note>,
) -> Placement {
    const PLACE: &str = "$.metadata.geographicalExtent";
    let declared = Placement::declared(transform);
    let Some(value) = metadata.and_then(|metadata| metadata.get("geographicalExtent")) else { return declared };
    let numbers: Vec<f64> = value.as_array().into_iter().flatten().filter_map(Value::as_f64).collect();
    let Ok([x0, y0, z0, x1, y1, z1]) = <[f64; 6]>::try_from(numbers) else {
        notes.push(note(Severity::Trap, file, PLACE, "not six numbers: not compared with the vertices".to_owned()));
        return declared;
    };
    let extent = Aabb { min: DVec3::new(x0, y0, z0), max: DVec3::new(x1, y1, z1) };
    let size = extent.max - extent.min;
    let slack = (TOLERANCE * size).max(DVec3::ONE);
    let inside = |of: Aabb| of.min.cmpge(extent.min - slack).all() && of.max.cmple(extent.max + slack).all();
    let computed = declared.bounds(raw);
    if inside(computed) {
        return declared;
    }
    let beyond = (extent.min - computed.min).max(computed.max - extent.max).max_element();
    let outside = computed.min.cmpgt(extent.max + slack).any() || computed.max.cmplt(extent.min - slack).any();
    let untranslated = Placement { translate: DVec3::ZERO, ..declared };
    let untransformed = Placement { scale: DVec3::ONE, translate: DVec3::ZERO };
    let repairs = [("its translation", untranslated), ("the transform", untransformed)];
    let proven = |repair: Placement| {
        let found = repair.bounds(raw);
        let filled = (found.max - found.min).truncate().cmpge(FILLED * size.truncate()).all();
        inside(found) && filled
    };
    if let Some((what, repair)) = repairs.into_iter().find(|&(_, repair)| outside && proven(repair)) {
        notes.push(note(
            Severity::Trap,
            file,
            "$.transform",
            format!(
                "the transform is applied twice: with it, the objects lie {beyond:.0} m outside of the file's own \
                 geographicalExtent (y {:.0} to {:.0} instead of {y0:.0} to {y1:.0})",
                computed.min.y, computed.max.y
            ),
        ));
        let found = repair.bounds(raw);
        let text = format!(
            "{what} was left out: then every vertex lies inside of the geographicalExtent (x {:.0} to {:.0}, y {:.0} to \
             {:.0})",
            found.min.x, found.max.x, found.min.y, found.max.y
        );
        notes.push(note(Severity::Repair, file, "$.transform", text));
        return repair;
    }
    let how = if outside { "wholly outside of" } else { "beyond" };
    let text = format!("objects lie {how} it, by {beyond:.1} m: the vertices are believed, not the extent");
    notes.push(note(Severity::Trap, file, PLACE, text));
    declared
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forms_of_a_reference_system() {
        for (text, code) in [
            ("https://www.opengis.net/def/crs/EPSG/0/7415", Some(7415)),
            ("http://www.opengis.net/def/crs/EPSG/0/28992", Some(28992)),
            ("urn:ogc:def:crs:EPSG::7415", Some(7415)),
            ("urn:ogc:def:crs:EPSG:9.8.1:2056", Some(2056)),
            ("EPSG:25832", Some(25832)),
            ("epsg:25832", Some(25832)),
            ("urn:ogc:def:crs,crs:EPSG::28992,crs:EPSG::5709", Some(28992)),
            (
                "https://www.opengis.net/def/crs-compound?1=http://www.opengis.net/def/crs/EPSG/0/2056&2=http://www.opengis.net/def/crs/EPSG/0/5728",
                Some(2056),
            ),
            ("https://www.opengis.net/def/crs/OGC/0/CRS84", None),
            ("EPSG", None),
            ("EPSG::", None),
            ("urn:ogc:def:crs:EPSG::99999999999", None),
        ] {
            assert_eq!(epsg_code(text), code, "{text}");
        }
        assert_eq!([7415, 5555, 5973, 10164, 2056].map(horizontal), [28992, 25832, 25833, 6671, 2056]);
    }
}
