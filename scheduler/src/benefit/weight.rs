//! The formulas that weights are made of, shared by the cuts of views and by the integral over a path.

use glam::DVec3;

/// Σ ι·A_ℓ(u), m², from the face areas summed by axis (`LodTree::face_areas`), along the unit vector `direction`.
pub fn projected_area(face_areas: DVec3, direction: DVec3) -> f64 {
    face_areas.dot(direction.abs())
}

/// Weight of a group, sr: the leaves' projected areas / d², for its centre relative to the eye at `distance` > 0 (m).
pub fn of_group(face_areas: DVec3, centre: DVec3, distance: f64) -> f64 {
    projected_area(face_areas, centre / distance) / (distance * distance)
}

/// Share of a small box inside the planes that cut it: a ramp over its extent across each plane.
pub fn share_inside(planes: &[DVec3; 4], centre: DVec3, half: DVec3, straddled: u8) -> f64 {
    let mut share = 1.0;
    for (i, plane) in planes.iter().enumerate() {
        if straddled & (1 << i) != 0 {
            let extent = plane.abs().dot(half);
            if extent > 0.0 {
                share *= (0.5 + 0.5 * plane.dot(centre) / extent).clamp(0.0, 1.0);
            }
        }
    }
    share
}

/// Smallest cosine to the view's centre that κ knows: towards and behind the plane of the eye the tangent grows without
/// bound, and the floor keeps κ positive.
pub const COSINE_MIN: f64 = 0.05;

/// 1/κ = 1 + falloff·tan²θ ≥ 1, for a centre relative to the eye at `distance` (m) and the view's unit `forward`.
pub fn off_centre(falloff: f64, forward: DVec3, centre: DVec3, distance: f64) -> f64 {
    let along = forward.dot(centre);
    let across_squared = (distance * distance - along * along).max(0.0);
    let along = along.max(COSINE_MIN * distance).max(f64::MIN_POSITIVE);
    1.0 + falloff * across_squared / (along * along)
}

/// Distance, m, from the eye to the nearest point of a box; 0 from within.
pub fn nearest_distance(centre: DVec3, half: DVec3) -> f64 {
    (centre.abs() - half).max(DVec3::ZERO).length()
}
