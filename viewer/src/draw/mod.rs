//! What to draw of what is there: from the LOD tree, the resident representations and the view to a list.

pub mod list;
