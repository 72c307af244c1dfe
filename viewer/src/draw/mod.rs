//! What to draw of what is there: from the LOD tree, the resident representations and the view to a list; and how fine, so
//! that frames take the time that they may.

pub mod choose;
pub mod controller;
pub mod environment;
pub mod list;
pub mod tiles;
