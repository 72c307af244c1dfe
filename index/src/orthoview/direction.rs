//! The 26 canonical directions, {−1, 0, 1}³ without 0 (\[HIBR\] §4.1), and how to choose among them.

use glam::DVec3;

/// A canonical direction: from which side a cell is looked at. It points from the cell to the eye.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Direction(u8);

impl Direction {
    /// All 26, in order of x, then y, then z.
    pub fn all() -> impl Iterator<Item = Direction> {
        (0..27).filter(|&code| code != 13).map(Direction)
    }

    /// The direction with these signs; `None` for 0 and for what is not −1, 0 or 1.
    pub fn from_signs(signs: [i32; 3]) -> Option<Direction> {
        if signs == [0; 3] || signs.iter().any(|s| !(-1..=1).contains(s)) {
            return None;
        }
        let code = signs.iter().fold(0, |code, s| 3 * code + (s + 1));
        u8::try_from(code).ok().map(Direction)
    }

    /// 9(x + 1) + 3(y + 1) + (z + 1), as LOD trees have it.
    pub fn code(self) -> u8 {
        self.0
    }

    /// The direction of that code.
    pub fn from_code(code: u8) -> Option<Direction> {
        (code < 27 && code != 13).then_some(Direction(code))
    }

    /// −1, 0 or 1 along each axis.
    pub fn signs(self) -> [i32; 3] {
        let code = i32::from(self.0);
        [code / 9 - 1, code / 3 % 3 - 1, code % 3 - 1]
    }

    /// Unit vector from the cell towards the eye.
    pub fn towards_eye(self) -> DVec3 {
        DVec3::from_array(self.signs().map(f64::from)).normalize()
    }

    /// The image's axes in the world, right and up, unit vectors. With [`Direction::towards_eye`] a right-handed frame.
    /// Up is along z where the direction is not, else along y.
    pub fn image_axes(self) -> [DVec3; 2] {
        let out = self.towards_eye();
        let guide = if self.signs()[0] == 0 && self.signs()[1] == 0 { DVec3::Y } else { DVec3::Z };
        let right = guide.cross(out).normalize();
        [right, out.cross(right)]
    }

    /// A name for files: `n`, `o`, `p` for −1, 0, 1 along x, y, z, as in `oop` for the view from above (z up).
    pub fn name(self) -> String {
        self.signs().iter().map(|s| ["n", "o", "p"][(s + 1) as usize]).collect()
    }

    /// The direction of that name.
    pub fn from_name(name: &str) -> Option<Direction> {
        let bytes: [u8; 3] = name.as_bytes().try_into().ok()?;
        let sign = |byte| match byte {
            b'n' => Some(-1),
            b'o' => Some(0),
            b'p' => Some(1),
            _ => None,
        };
        Direction::from_signs([sign(bytes[0])?, sign(bytes[1])?, sign(bytes[2])?])
    }
}

/// Nine directions for worlds that are seen from the ground up, z up: from above, the four sides, the four upper corners.
/// At most 36° lie between a surface that does not face down and one that looks at it (the papers name none: DESIGN §1).
pub fn nine() -> [Direction; 9] {
    [[0, 0, 1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [1, 1, 1], [1, -1, 1], [-1, 1, 1], [-1, -1, 1]]
        .map(|signs| Direction::from_signs(signs).expect("canonical"))
}

/// [`nine`] for a world whose up is nearest to another axis: its own axes take the places of x, y and z in turn.
pub fn nine_about(up: DVec3) -> [Direction; 9] {
    let size = up.abs();
    let axis = if size.z >= size.x && size.z >= size.y { 2 } else { usize::from(size.y >= size.x) };
    let sign = if up[axis] < 0.0 { -1 } else { 1 };
    nine().map(|direction| {
        let [x, y, z] = direction.signs();
        let mut signs = [0; 3];
        (signs[axis], signs[(axis + 1) % 3], signs[(axis + 2) % 3]) = (sign * z, x, y);
        Direction::from_signs(signs).expect("canonical")
    })
}

/// How surfaces are spread over orientations: area by unit normal.
pub type Orientations<'a> = &'a [(DVec3, f64)];

/// How well a set of directions sees surfaces.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sight {
    /// Largest angle between a surface and the nearest direction, over surfaces that any direction faces, radians.
    pub largest_angle: f64,
    /// Share of the area whose nearest direction is within `limit`.
    pub share_within: f64,
    /// Share of the area that no direction faces at all.
    pub share_unseen: f64,
}

/// How well `directions` see surfaces of these orientations, occlusion ignored; `limit` in radians. All zero without area.
pub fn sight(directions: &[Direction], orientations: Orientations<'_>, limit: f64) -> Sight {
    let mut sight = Sight { largest_angle: 0.0, share_within: 0.0, share_unseen: 0.0 };
    let mut total = 0.0;
    for &(normal, area) in orientations.iter().filter(|(normal, area)| normal.is_finite() && *area > 0.0) {
        total += area;
        let cosine = directions.iter().map(|d| d.towards_eye().dot(normal)).fold(-1.0, f64::max);
        if cosine <= 1e-9 {
            sight.share_unseen += area;
            continue;
        }
        let angle = libm::acos(cosine.min(1.0));
        sight.largest_angle = sight.largest_angle.max(angle);
        if angle <= limit {
            sight.share_within += area;
        }
    }
    if total > 0.0 {
        sight.share_within /= total;
        sight.share_unseen /= total;
    }
    sight
}

/// At most `most` directions, chosen greedily: each the one that adds most Σ area × cosine of the best angle so far, a
/// facility-location function like the benefit itself. Stops early where none adds more than `least` of the total area.
/// The order is the order of choice; ties go to the lower direction.
pub fn choose(orientations: Orientations<'_>, most: usize, least: f64) -> Vec<Direction> {
    let surfaces: Vec<_> = orientations.iter().filter(|(n, area)| n.is_finite() && *area > 0.0).collect();
    let total: f64 = surfaces.iter().map(|(_, area)| area).sum();
    let mut best = vec![0.0f64; surfaces.len()];
    let mut chosen = Vec::new();
    while chosen.len() < most {
        let gain = |d: Direction| -> f64 {
            let eye = d.towards_eye();
            surfaces.iter().zip(&best).map(|((n, area), have)| area * (eye.dot(*n) - have).max(0.0)).sum()
        };
        let mut winner: Option<(f64, Direction)> = None;
        for direction in Direction::all().filter(|d| !chosen.contains(d)) {
            let gained = gain(direction);
            if winner.is_none_or(|(most, _)| gained > most) {
                winner = Some((gained, direction));
            }
        }
        let Some((gained, direction)) = winner.filter(|(gained, _)| *gained > least * total && *gained > 0.0) else {
            break;
        };
        debug_assert!(gained.is_finite());
        let eye = direction.towards_eye();
        for ((normal, _), have) in surfaces.iter().zip(&mut best) {
            *have = have.max(eye.dot(*normal));
        }
        chosen.push(direction);
    }
    chosen
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Normals spread evenly over the sphere (Fibonacci), each with the same area.
    fn sphere(count: usize, keep: impl Fn(DVec3) -> bool) -> Vec<(DVec3, f64)> {
        let golden = core::f64::consts::PI * (3.0 - 5f64.sqrt());
        (0..count)
            .map(|i| {
                let z = 1.0 - (2.0 * i as f64 + 1.0) / count as f64;
                let (radius, angle) = ((1.0 - z * z).sqrt(), golden * i as f64);
                DVec3::new(radius * libm::cos(angle), radius * libm::sin(angle), z)
            })
            .filter(|&n| keep(n))
            .map(|n| (n, 1.0))
            .collect()
    }

    #[test]
    fn there_are_26_and_each_has_a_right_handed_frame_and_a_name() {
        assert_eq!(Direction::all().count(), 26);
        for d in Direction::all() {
            let (out, [right, up]) = (d.towards_eye(), d.image_axes());
            assert!((right.cross(up) - out).length() < 1e-12, "{d:?}");
            assert!(right.z.abs() < 1e-12, "right is level");
            assert_eq!(Direction::from_name(&d.name()), Some(d));
            assert_eq!(Direction::from_signs(d.signs()), Some(d));
        }
        assert_eq!(nine()[0].name(), "oop");
        for wrong in ["", "ooo", "oopp", "xop"] {
            assert_eq!(Direction::from_name(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn the_nine_leave_at_most_36_degrees_on_what_does_not_face_down() {
        let upper = sphere(40_000, |n| n.z >= 0.0);
        let seen = sight(&nine(), &upper, 36f64.to_radians());
        assert!(seen.largest_angle.to_degrees() < 36.3, "{}", seen.largest_angle.to_degrees());
        assert!(seen.share_within > 0.995);
        // Faces alone: [HIBR] says about 55° for the six of a cube.
        let faces: Vec<_> = Direction::all().filter(|d| d.signs().iter().filter(|s| **s != 0).count() == 1).collect();
        let all = sphere(40_000, |_| true);
        assert!((sight(&faces, &all, 1.0).largest_angle.to_degrees() - 54.7).abs() < 0.5);
    }

    #[test]
    fn the_nine_follow_the_worlds_up() {
        assert_eq!(nine_about(DVec3::Z), nine());
        for up in [DVec3::X, DVec3::NEG_Y, DVec3::new(0.1, 0.2, -0.9)] {
            let turned = nine_about(up);
            let away = turned.iter().filter(|d| d.towards_eye().dot(up) < -0.2).count();
            assert!(away == 0 && turned.iter().all(|d| turned.iter().filter(|e| *e == d).count() == 1), "{up}");
            assert!(turned[0].towards_eye().dot(up) > 0.9 * up.length());
        }
    }

    #[test]
    fn a_flat_world_needs_one_direction_and_a_box_five() {
        assert_eq!(choose(&[(DVec3::Z, 5.0)], 9, 1e-3), [nine()[0]]);
        let walls = [DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y, DVec3::Z].map(|n| (n, 1.0));
        let chosen = choose(&walls, 26, 1e-3);
        assert_eq!(sight(&chosen, &walls, 1e-6).share_within, 1.0);
        assert!(choose(&[], 9, 0.0).is_empty());
        assert!(choose(&[(DVec3::NAN, 1.0), (DVec3::X, f64::NAN)], 9, 0.0).is_empty());
    }
}
