//! Where the files of a stored world are, relative to its folder, with `/`. A name holds the beginning of its content's
//! hash: a file never changes, and what two versions share is there once.

use super::page::{Hash, Kind};
use crate::octree::Cell;
use std::fmt::Write as _;

/// The one file that changes: it names the version.
pub const DOCUMENT: &str = "world.toml";

/// What a build in progress keeps.
pub const BUILDING: &str = "building";

/// Held locked by a build.
pub const LOCK: &str = "build.lock";

/// 16 hexadecimal digits.
pub fn digits(hash: &Hash) -> String {
    hash[..8].iter().fold(String::with_capacity(16), |mut text, byte| {
        let _ = write!(text, "{byte:02x}");
        text
    })
}

fn cell_name(cell: Cell) -> String {
    let [x, y, z] = cell.place;
    format!("{}/{x}_{y}_{z}", cell.level)
}

/// Of a page.
pub fn page(cell: Cell, hash: &Hash) -> String {
    format!("nodes/{}.{}.page", cell_name(cell), digits(hash))
}

/// Folder and name of a representation's file.
pub fn representation(cell: Cell, kind: Kind, hash: &Hash) -> (String, String) {
    let digits = digits(hash);
    match kind {
        Kind::Orthoview(direction) => {
            (format!("orthoviews/{}/", cell_name(cell)), format!("{}.{digits}.fsov", direction.name()))
        }
        Kind::Geometry(level) => {
            let [x, y, z] = cell.place;
            (format!("geometry/{x}_{y}_{z}/"), format!("{level}.{digits}.glb"))
        }
    }
}

/// Of the catalogue of a world of this identity.
pub fn catalogue(identity: &str) -> String {
    format!("catalogue.{}.sqlite", identity.get(..16).unwrap_or(identity))
}
