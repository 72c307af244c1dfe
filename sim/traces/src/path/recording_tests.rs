//! Recordings as they are written, cut off, and made up by others.

use glam::{DQuat, DVec3};
use proptest::prelude::*;

use super::parse::{self, Options};
use super::recording::{Sample, Writer, from_bytes};
use super::{CameraPath, Frame, Heights, Pose, teleport};

fn written(path: &CameraPath) -> Vec<u8> {
    let mut writer = Writer::new("t", Vec::new(), path.frame(), path.up()).unwrap();
    for (i, pose) in path.poses().iter().enumerate() {
        let stated = (i == 0).then_some(1.0);
        let sample = Sample {
            t: pose.time,
            position: pose.position.to_array(),
            orientation: pose.orientation.to_array(),
            fov_y: stated,
            viewport: stated.map(|_| [640, 480]),
        };
        writer.push(&sample).unwrap();
    }
    writer.finish().unwrap()
}

fn read(bytes: &[u8]) -> Result<CameraPath, String> {
    parse::from_bytes("t", bytes, &Options::default()).map_err(|error| error.to_string())
}

const HEADER: &str = r#"{"format":"foresight-recording","schema_version":1,"frame":"local","up":[0,0,2]}"#;

fn line(t: f64) -> String {
    format!(r#"{{"t":{t},"position":[{t},0,0],"orientation":[0,0,0,1]}}"#)
}

#[test]
fn what_is_written_is_read_to_the_last_bit() {
    let path = teleport::teleport(1.5, 20.0, 3.3, 77.7, 5).unwrap();
    let again = read(&written(&path)).unwrap();
    assert_eq!(again.poses(), path.poses());
    assert_eq!((again.hash(), again.up()), (path.hash(), path.up()));
    let notes = again.notes().join("\n");
    assert!(notes.contains("field of view of 57.30° (see") && notes.contains("640 × 480 (see"), "{notes}");
}

#[test]
fn a_recording_on_the_earth_keeps_what_its_heights_are_above() {
    let pose = |k: u32| Pose {
        time: f64::from(k),
        position: DVec3::new(4.0e6, 3.0e6 + f64::from(k), 3.9e6),
        orientation: DQuat::IDENTITY,
    };
    for heights in [Heights::Ellipsoid, Heights::SeaLevel, Heights::Pressure, Heights::Ground] {
        let path = CameraPath::on_earth("t", (0..9).map(pose).collect(), heights).unwrap();
        let again = read(&written(&path)).unwrap();
        assert_eq!((again.frame(), again.hash()), (Frame::Earth(heights), path.hash()));
    }
    let unsaid = HEADER.replace("local", "earth");
    let lines = [&unsaid, &line(6.4e6), &line(6.5e6)].map(String::as_str).join("\n");
    assert_eq!(read(lines.as_bytes()).unwrap().frame(), Frame::Earth(Heights::Ellipsoid));
}

#[test]
fn a_recording_cut_off_anywhere_keeps_its_whole_lines() {
    let path = teleport::teleport(1.5, 0.2, 0.1, 7.0, 5).unwrap();
    let bytes = written(&path);
    let whole = from_bytes("t", &bytes).unwrap();
    for end in 0..bytes.len() {
        let lines = bytes[..end].split(|&b| b == b'\n').count();
        match from_bytes("t", &bytes[..end]) {
            // A last line without its line feed may be whole.
            Ok(cut) => {
                let n = cut.samples.len();
                assert!(n == lines - 1 || n + 2 == lines, "{n} of {lines}");
                assert_eq!(cut.samples, whole.samples[..n]);
                let is_truncated = bytes[end - 1] != b'\n' && n + 2 == lines;
                assert_eq!(cut.notes.iter().any(|note| note.contains("truncated")), is_truncated, "{end}");
            }
            Err(_) => assert_eq!(lines, 1),
        }
    }
}

#[test]
fn repairs_are_noted_and_the_rest_refused() {
    let lines = |lines: &[&str]| read([&[HEADER], lines].concat().join("\n").as_bytes());
    let (a, b, c) = (line(5.0), line(6.0), line(7.5));
    let path = lines(&[&a, &b, &b, &c]).unwrap();
    assert_eq!((path.poses().len(), path.duration(), path.up()), (3, 2.5, DVec3::Z));
    assert!(path.notes().iter().any(|note| note.starts_with("1 poses dropped")), "{:?}", path.notes());
    let off = r#"{"t":9,"position":[0,0,0],"orientation":[0,0,0,1.005],"user":"x"}"#;
    let path = lines(&[&a, off]).unwrap();
    assert_eq!(path.poses()[1].orientation, DQuat::IDENTITY);
    assert!(path.notes().iter().any(|note| note.starts_with("1 quaternions")), "{:?}", path.notes());

    let newer = HEADER.replace(":1,", ":2,").replace("frame", "system");
    assert!(read(newer.as_bytes()).unwrap_err().contains("line 1: schema version 2; this program reads 1"));
    assert!(read(HEADER.replace("local", "moon").as_bytes()).unwrap_err().contains("line 1: unknown variant `moon`"));
    assert!(read(HEADER.replace("[0,0,2]", "[0,0,0]").as_bytes()).unwrap_err().contains("expected a direction"));
    assert!(lines(&[&a]).unwrap_err().contains("at least 2 poses"));
    for (bad, message) in [
        (r#"{"t":"x","position":[0,0,0],"orientation":[0,0,0,1]}"#, "is no finite number"),
        (r#"{"t":1e999,"position":[0,0,0],"orientation":[0,0,0,1]}"#, "is no finite number"),
        (r#"{"t":1,"position":[0,0],"orientation":[0,0,0,1]}"#, "expected t, position of 3"),
        (r#"{"t":1,"position":[0,0,0],"orientation":[0,0,0,0]}"#, "a quaternion of length 0"),
        (r#"{"t":1,"position":[0,2e12,0],"orientation":[0,0,0,1]}"#, "a coordinate of 2000000000000"),
        (r#"{"t":1,"position":[0,0,0],"orientation":[0,0,0,1],"fov_y":4}"#, "fov_y 4"),
        (r#"{"t":1,"position":[0,0,0],"orientation":[0,0,0,1],"viewport":[0,9]}"#, "a viewport of 0 × 9"),
        (r#"{"t":1"#, "line 2: EOF"),
    ] {
        let error = lines(&[bad, &b, &c]).unwrap_err();
        assert!(error.contains("line 2") && error.contains(message), "{bad}: {error}");
    }
}

proptest! {
    #[test]
    fn no_bytes_make_it_panic(bytes in prop::collection::vec(any::<u8>(), 0..200), at in 0usize..400) {
        let _ = from_bytes("t", &[HEADER.as_bytes(), b"\n", &bytes].concat());
        let mut whole = [HEADER.to_owned(), line(0.0), line(1.0), line(2.0)].join("\n").into_bytes();
        let at = at % whole.len();
        whole.splice(at..at + 1, bytes);
        let _ = read(&whole);
    }
}
