//! What a view is worth: weight × accuracy, over a cut of the tree (B_R(v) = Σ w q).

pub mod accuracy;
pub mod coverage;
pub mod cut;
pub mod element;
pub mod frustum;
pub mod quality;
pub mod solid_angle;
pub mod weight;
