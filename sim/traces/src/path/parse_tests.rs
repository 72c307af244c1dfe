//! Paths as they come, and as they must not; and what is read off the motion of recorded ones.

use glam::DVec3;
use proptest::prelude::*;

use super::parse::{Options, from_bytes, from_file};
use super::{CameraAxes, CameraPath, QuatOrder};
use crate::recorded::data;

fn parse(text: &str) -> Result<CameraPath, String> {
    from_bytes("t", text.as_bytes(), &Options::default()).map_err(|error| error.to_string())
}

fn has_note(path: &CameraPath, part: &str) -> bool {
    path.notes().iter().any(|note| note.contains(part))
}

const HEADER: &str =
    "ViewIndex,FOV1,PositionX,PositionY,PositionZ,QuaternionX,QuaternionY,QuaternionZ,QuaternionW,Timestamp\n";

#[test]
fn tum_lines_are_read_with_optical_axes() {
    // An optical camera (+z ahead, −y up) that is not turned looks along the frame's +z with the frame's −y up.
    let path = parse("\u{feff}# t x y z q\r\n100.5 1 2 3 0 0 0 1\r\n\r\n101.5\t1 2 3 0 0 0 1 7 8\n").unwrap();
    assert_eq!(path.duration(), 1.0);
    assert_eq!(path.up(), DVec3::Z);
    let (p, q) = path.at(0.0);
    assert_eq!(p, DVec3::new(1.0, 2.0, 3.0));
    assert!((q * -DVec3::Z).distance(DVec3::Z) < 1e-12 && (q * DVec3::Y).distance(-DVec3::Y) < 1e-12);
    assert!(has_note(&path, "1 lines with more than 8 columns"));
    assert!(has_note(&path, "weak evidence"), "{:?}", path.notes());
}

#[test]
fn eye_nav_takes_one_view_and_milliseconds() {
    let rows = "0,9,1,2,3,0,0,0,1,0\n1,9,9,9,9,0,0,0,1,4\n0,9,1,2,2,0,0,0,0.995,500\n";
    let path = parse(&format!("{HEADER}{rows}")).unwrap();
    assert_eq!((path.poses().len(), path.duration(), path.up()), (2, 0.5, DVec3::Y));
    assert!((path.at(0.0).1 * -DVec3::Z).distance(-DVec3::Z) < 1e-12);
    assert!(has_note(&path, "1 of 2 quaternions renormalised"));
    assert!(parse(&HEADER.replace("PositionY", "Y")).unwrap_err().contains("a header without PositionY"));
    assert!(parse(&format!("{HEADER}0,1\n")).unwrap_err().contains("line 2: 2 columns; expected a column 10"));
    assert!(parse(&format!("{HEADER}0,9,a,2,3,0,0,0,1,0\n")).unwrap_err().contains("column 3 is no number"));
    assert!(parse(&format!("{HEADER}1,9,1,2,3,0,0,0,1,0\n")).unwrap_err().contains("at least 2 poses"));
}

#[test]
fn options_overrule_the_motion() {
    let options = Options {
        camera_axes: Some("+x/+z".parse().unwrap()),
        quat_order: Some("wxyz".parse().unwrap()),
        up: Some("-y".parse().unwrap()),
        ..Options::default()
    };
    let path = from_bytes("t", b"0 0 0 0 1 0 0 0\n1 0 5 0 1 0 0 0\n", &options).unwrap();
    assert_eq!(path.up(), -DVec3::Y);
    assert!((path.at(0.0).1 * -DVec3::Z).distance(DVec3::X) < 1e-12);
    assert!((path.at(0.0).1 * DVec3::Y).distance(DVec3::Z) < 1e-12);
    assert!(has_note(&path, "as given"));
    for bad in ["", "z", "+z/-z", "+z/y/x", "w/+y", "+z/"] {
        assert!(bad.parse::<CameraAxes>().is_err(), "{bad}");
    }
    assert_eq!("z / −y".parse::<CameraAxes>().unwrap().to_string(), "+z/-y");
    assert!("xywz".parse::<QuatOrder>().is_err());
}

#[test]
fn what_is_no_path_is_refused_with_the_place() {
    let long = format!("0 1 2 3 0 0 0 1\n1 1 2 3 0 0 0 1 {}\n", "4 ".repeat(40_000));
    assert!(parse(&long).unwrap_err().contains("line 2: is longer than"));
    assert!(parse("").unwrap_err().contains("is empty"));
    assert!(parse("# only a comment\n").unwrap_err().contains("is empty"));
    assert!(parse("0 1 2 3 0 0 0 1\n").unwrap_err().contains("a path needs at least 2 poses"));
    assert!(parse("0 8\n1 8\n").unwrap_err().contains("line 1: `0 8` is not a supported path format"));
    assert!(parse("<svg/>\n").unwrap_err().contains("not a supported path format"));
    assert!(parse("0 1 2 3 0 0 0 1\n1 2 3\n").unwrap_err().contains("line 2: 3 columns"));
    assert!(parse("0 1 2 3 0 0 0 1\n1 2 3 x 0 0 0 1\n").unwrap_err().contains("line 2: column 4 is no number"));
    assert!(parse("#\n0 1 2 3 0 0 0 0\n").unwrap_err().contains("line 2: a quaternion of length 0"));
    assert!(
        parse("0 1 2 3 0 0 0 1\n1 1 2 3 0 0 0 1.02\n").unwrap_err().contains("line 2: a quaternion of length 1.02")
    );
    assert!(parse("0 1 2 NaN 0 0 0 1\n").unwrap_err().contains("line 1: NaN; expected finite"));
    assert!(parse("0 1 2 inf 0 0 0 1\n").unwrap_err().contains("line 1: inf; expected finite"));
    assert!(parse("0 1 2 3 0 0 1e200 1\n").unwrap_err().contains("quaternion of length inf"));
    assert!(parse("0 1e13 2 3 0 0 0 1\n").unwrap_err().contains("expected at most"));
    assert!(parse("0 1 2 3 0 0 0 1\n1e300 1 2 3 0 0 0 1\n").unwrap_err().contains("after the first pose"));
    assert!(parse("3 1 2 3 0 0 0 1\n2 1 2 3 0 0 0 1\n1 1 2 3 0 0 0 1\n").unwrap_err().contains("2 of 3 times"));
}

#[test]
fn repairs_are_counted() {
    let path =
        parse("0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1.005\n1 9 9 9 0 0 0 1\n0.5 9 9 9 0 0 0 1\n2 2 0 0 0 0 0 1\n").unwrap();
    assert_eq!(path.poses().len(), 3);
    assert!(has_note(&path, "2 of 5 poses dropped") && has_note(&path, "1 of 5 quaternions renormalised"));
    assert!(path.poses().iter().all(|pose| pose.orientation.is_normalized()));
}

/// A drive around a circle, written with the given axes and order, in a frame with the given up.
fn drive(axes: &str, order: &str, up: char) -> String {
    use glam::{DMat3, DQuat};
    let axes: CameraAxes = axes.parse().unwrap();
    let mut text = String::new();
    for k in 0..400 {
        let t = f64::from(k) * 0.1;
        let (s, c) = (libm::sin(0.2 * t), libm::cos(0.2 * t));
        let (mut position, mut ahead, mut above) =
            (DVec3::new(50.0 * c, 50.0 * s, 2.0), DVec3::new(-s, c, 0.0), DVec3::Z);
        if up == 'y' {
            // The same turned by −90° about x.
            let turn = |v: DVec3| DVec3::new(v.x, v.z, -v.y);
            (position, ahead, above) = (turn(position), turn(ahead), turn(above));
        }
        let world_from_canonical = DQuat::from_mat3(&DMat3::from_cols(ahead.cross(above), above, -ahead));
        let q = world_from_canonical * axes.from_canonical().inverse();
        let numbers = if order == "wxyz" { [q.w, q.x, q.y, q.z] } else { q.to_array() };
        let [x, y, z] = position.to_array();
        let [a, b, c, d] = numbers;
        text.push_str(&format!("{t} {x} {y} {z} {a} {b} {c} {d}\n"));
    }
    text
}

#[test]
fn the_motion_gives_away_axes_order_and_up() {
    for axes in ["+z/-y", "-z/+y", "-z/-y", "-y/+z", "+x/+z", "+z/+y", "-x/-z", "+y/+x"] {
        for order in ["xyzw", "wxyz"] {
            // On level ground two conventions may explain the same poses; what counts is where the camera looks.
            let path = parse(&drive(axes, order, 'z')).unwrap();
            let (p, q) = path.at(10.0);
            let ahead = (path.at(10.1).0 - p).normalize();
            assert!((q * -DVec3::Z).dot(ahead) > 0.99, "{axes} {order}: {:?}", path.notes());
            assert!((q * DVec3::Y).dot(DVec3::Z) > 0.99, "{axes} {order}: {:?}", path.notes());
        }
    }
    let path = parse(&drive("+z/-y", "xyzw", 'y')).unwrap();
    assert_eq!(path.up(), DVec3::Y, "{:?}", path.notes());
    assert!((path.at(10.0).1 * DVec3::Y).dot(DVec3::Y) > 0.99);
    assert!(has_note(&path, "the frame's up is +y"), "{:?}", path.notes());
    // A camera frame's first pose: y down, though nothing follows the motion.
    assert_eq!(parse("0 0 0 0 0 0 0 1\n1 1 0.1 1 0 0 0 1\n").unwrap().up(), -DVec3::Y);
    // A camera that looks down from a survey with its picture's top to the north: the ground is still across z.
    let rows = (0..200).map(|k| format!("{k} {} {} 80 1 0 0 0\n", k % 20, k / 2)).collect::<String>();
    let path = parse(&rows).unwrap();
    assert_eq!(path.up(), DVec3::Z, "{:?}", path.notes());
}

#[test]
fn recorded_paths_are_read_the_way_they_were_recorded() {
    let Some(folder) = data("paths") else { return };
    // (file, forward/up, order): what is known about each.
    for (file, axes, order) in [
        ("drive_udel_garage.txt", "-z/-y", "wxyz"),
        ("walk_tumvi_magistrale1_vinsmono.txt", "-y/+z", "xyzw"),
        ("walk_udel_gore.txt", "+z/+y", "xyzw"),
        ("survey_georeferenced_utm.tum", "+x/+z", "xyzw"),
        ("handheld_tum_fr2_desk_gt.txt", "+z/-y", "xyzw"),
        ("handheld_tumvi_room1_gt.txt", "-y/+z", "xyzw"),
        ("vr_head_rutgers_berlin_user101.csv", "-z/+y", "xyzw"),
        ("vr_head_rutgers_nyc_user101.csv", "-z/+y", "xyzw"),
        ("vr_head_rutgers_playroom_user101.csv", "-z/+y", "xyzw"),
    ] {
        let path = from_file(&folder.join(file), &Options::default()).unwrap();
        println!("{file}: {} poses, {:.1} s, {:?}", path.poses().len(), path.duration(), path.notes());
        assert!(has_note(&path, &format!("camera axes {axes}, quaternions {order}")), "{file}: {:?}", path.notes());
    }
    let desk = from_file(&folder.join("handheld_tum_fr2_desk_gt.txt"), &Options::default()).unwrap();
    assert!(has_note(&desk, "gaps longer than"), "{:?}", desk.notes());
}

proptest! {
    #[test]
    fn no_bytes_make_it_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
        let _ = from_bytes("t", &bytes, &Options::default());
        let _ = from_bytes("t", &[HEADER.as_bytes(), &bytes].concat(), &Options::default());
    }

    #[test]
    fn nor_do_near_misses(lines in proptest::collection::vec("(-?[0-9]{1,3}(\\.[0-9])?(e[0-9]{1,3})? ){3}[0-9.]{1,4} 0 0 0 1", 0..6)) {
        if let Ok(path) = from_bytes("t", lines.join("\n").as_bytes(), &Options::default()) {
            for k in 0..=20 {
                let (p, q) = path.at(path.duration() * f64::from(k) / 20.0);
                prop_assert!(p.is_finite() && q.is_normalized());
            }
        }
    }
}
