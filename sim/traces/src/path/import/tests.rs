//! Recordings on the Earth as they come, and as they must not.

use std::io::Write;

use foresight_index::geodesy::Geodetic;
use glam::DVec3;
use proptest::prelude::*;

use super::super::facts::PathFacts;
use super::super::parse::{Format, Options, from_arrays, from_bytes, from_bytes_as, from_file, is_path_like};
use super::super::{CameraPath, Frame, Heights};
use crate::recorded::data;

fn parse_with(text: &str, options: &Options) -> Result<CameraPath, String> {
    from_bytes("t", text.as_bytes(), options).map_err(|error| error.to_string())
}

fn parse(text: &str) -> Result<CameraPath, String> {
    parse_with(text, &Options::default())
}

fn refusal(text: &str) -> String {
    parse(text).map(|_| ()).unwrap_err()
}

fn has_note(path: &CameraPath, part: &str) -> bool {
    path.notes().iter().any(|note| note.contains(part))
}

/// Where the camera looks (east, north, up), and what is up in its picture.
fn looks(path: &CameraPath, time: f64) -> (DVec3, DVec3) {
    let (p, q) = path.at(time);
    let level = path.level_axes(p).transpose();
    (level * (q * -DVec3::Z), level * (q * DVec3::Y))
}

fn at(path: &CameraPath, index: usize) -> [f64; 3] {
    let here = Geodetic::from_ecef(path.poses()[index].position).unwrap();
    [here.latitude.to_degrees(), here.longitude.to_degrees(), here.height]
}

fn near(found: [f64; 3], expected: [f64; 3]) -> bool {
    (found[0] - expected[0]).abs() < 1e-9
        && (found[1] - expected[1]).abs() < 1e-9
        && (found[2] - expected[2]).abs() < 1e-6
}

const GPX: &str = r#"<?xml version="1.0"?>
<gpx version="1.1" creator="hand" xmlns="http://www.topografix.com/GPX/1/1"><wpt lat="1" lon="1"><time>2000-01-01T00:00:00Z</time></wpt>
<trk><name>a &amp; b</name><trkseg><trkpt lat="47" lon="8"><ele>400</ele></trkpt></trkseg></trk>
<trk><trkseg>
<trkpt lat="47.0" lon="8.0"><ele>400</ele><time>2010-10-03T09:36:30Z</time><extensions><ele>9</ele></extensions></trkpt>
<trkpt lon="8.0" lat="47.001"><time>2010-10-03T11:36:40.5+02:00</time></trkpt>
</trkseg><trkseg><trkpt lat="47.002" lon="8.0"><ele>420</ele><time>2010-10-03T09:36:50</time></trkpt></trkseg></trk></gpx>"#;

#[test]
fn gpx_tracks_with_times() {
    let path = parse(GPX).unwrap();
    assert_eq!(path.frame(), Frame::Earth(Heights::SeaLevel));
    let times: Vec<f64> = path.poses().iter().map(|pose| pose.time).collect();
    assert_eq!(times, [0.0, 10.5, 20.0]);
    assert!(near(at(&path, 0), [47.0, 8.0, 400.0]) && near(at(&path, 2), [47.002, 8.0, 420.0]));
    assert!(near(at(&path, 1), [47.001, 8.0, 410.5]), "{:?}", at(&path, 1));
    assert!(has_note(&path, "begins 2010-10-03 09:36:30 UTC"));
    assert!(has_note(&path, "1 of 4 track points have no time"));
    assert!(has_note(&path, "1 of 3 heights are missing: interpolated"));
    assert!(has_note(&path, "2 track segments"));
    // Northwards, climbing 20 m over 222 m.
    let (ahead, up) = looks(&path, 10.5);
    assert!(ahead.distance(DVec3::new(0.0, 222.4, 20.0).normalize()) < 1e-3, "{ahead}");
    assert!(up.x.abs() < 1e-9 && up.z > 0.99);

    assert!(refusal(&GPX.replace("lat=\"47.001\"", "lat=\"97\"")).contains("line 6: a latitude of 97"));
    assert!(refusal(&GPX.replace("lat=\"47.001\"", "lat=\"x\"")).contains("line 6: lat `x`; expected a number"));
    assert!(refusal(&GPX.replace("lat=\"47.001\"", "")).contains("line 6: a trkpt without lat or lon"));
    assert!(refusal(&GPX.replace("2010-10-03T09:36:50", "noon")).contains("line 7: time `noon`"));
    assert!(refusal(&GPX.replace("<ele>420", "<ele>nan")).contains("line 7: ele `nan`"));
    assert!(refusal(&GPX[..GPX.len() - 6]).contains("the file ends within <gpx>"));
    assert!(refusal(&GPX.replace("</trkseg></trk></gpx>", "</gpx>")).contains("expected well-formed XML"));
    assert!(refusal("<gpx><trkpt lat='1' lon='2'/></gpx>").contains("none of 1 track points has a time"));
    assert!(refusal("<svg/>").contains("line 1: `<svg>` is not a supported path format"));
    assert!(refusal(&"<gpx>".repeat(300)).contains("nested deeper than"));
}

#[test]
fn igc_fixes_across_midnight() {
    let text = "AXXX\r\nHFDTEDATE:311299,01\r\nHFALGALTGPS:GEO\r\nI023636LAD3737LOD\r\n\
                B2359584530000N00030000WA001000020055\r\nB2359594530000N00030000WV0010000200\r\n\
                B0000004530000N00030000WA00110-010000\r\nLXXX B comment\r\n";
    let path = parse(text).unwrap();
    assert_eq!(path.frame(), Frame::Earth(Heights::SeaLevel));
    assert_eq!((path.poses().len(), path.duration()), (2, 2.0));
    // 45° 30.0005′ north, 0° 30.0005′ west: the last two digits of the line belong to the minutes.
    assert!(near(at(&path, 0), [45.5 + 0.0005 / 60.0, -(0.5 + 0.0005 / 60.0), 200.0]), "{:?}", at(&path, 0));
    assert!(near(at(&path, 1), [45.5, -0.5, -100.0]));
    assert!(has_note(&path, "begins 1999-12-31 23:59:58 UTC"));
    assert!(has_note(&path, "1 of 3 fixes without GNSS") && has_note(&path, "1 times past midnight"));
    assert!(has_note(&path, "on average -55.0 m against the pressure altitudes"));
    let pressure = parse("B1000004530000N00030000EA0010000000\nB1000014530000N00030000EA0010200000\n").unwrap();
    assert_eq!(pressure.frame(), Frame::Earth(Heights::Pressure));
    assert!(has_note(&pressure, "no date record") && !has_note(&pressure, "begins"));
    assert!(near(at(&pressure, 1), [45.5, 0.5, 102.0]));
    assert!(refusal("HFDTE010199\nB1000004530000N00030000EA00100\n").contains("line 2: fix `B100000"));
    assert!(refusal("HFDTE010199\nB1000004530000N00030000EX0010000000\n").contains("line 2: fix"));
    assert!(refusal("HFDTE320199\nB1000004530000N00030000EA0010000000\n").contains("line 1: date `HFDTE320199`"));
    assert!(refusal("HFDTE010199\nB1000009930000N00030000EA0010000000\n").contains("line 2"));
    assert!(refusal("HFDTE010199\nB1000004530000N00030000EV0010000000\n").contains("no valid fix (1 without GNSS)"));
    assert!(refusal("HFDTE010199\n").contains("no valid fix"));
}

fn kml(inner: &str) -> String {
    format!("<kml xmlns='http://www.opengis.net/kml/2.2' xmlns:gx='x'><Document>{inner}</Document></kml>")
}

#[test]
fn kml_tracks_with_a_models_angles() {
    let track = "<Placemark><gx:Track><altitudeMode>absolute</altitudeMode>\n<when>2010-05-28T02:02:09Z</when>\
                 <when>2010-05-28T02:02:10Z</when><when>2010-05-28T02:02:11Z</when>\n<gx:coord>-122.2 37.3 156</gx:coord>\
                 <gx:coord>-122.2 37.3 157</gx:coord><gx:coord/>\n<gx:angles>90 10 0</gx:angles><gx:angles>0 0 90</gx:angles>\
                 </gx:Track></Placemark>";
    let path = parse(&kml(track)).unwrap();
    assert_eq!(path.frame(), Frame::Earth(Heights::SeaLevel));
    assert_eq!((path.poses().len(), path.duration()), (2, 1.0));
    assert!(near(at(&path, 1), [37.3, -122.2, 157.0]));
    let (sine, cosine) = (libm::sin(10f64.to_radians()), libm::cos(10f64.to_radians()));
    let (ahead, up) = looks(&path, 0.0);
    assert!(ahead.distance(DVec3::new(cosine, 0.0, -sine)) < 1e-9 && up.distance(DVec3::new(sine, 0.0, cosine)) < 1e-9);
    // The left side down: what is up in the picture points west.
    let (ahead, up) = looks(&path, 1.0);
    assert!(ahead.distance(DVec3::Y) < 1e-9 && up.distance(-DVec3::X) < 1e-9, "{ahead} {up}");
    assert!(has_note(&path, "1 of 3 times have no position"));
    let two = format!("{}{track}", track.replace("<when>2010-05-28T02:02:11Z</when>", "").replace("<gx:coord/>", ""));
    assert!(has_note(&parse(&kml(&two)).unwrap(), "2 gx:Tracks: the longest taken"));
    // The pieces of a MultiTrack follow each other; without a mode they lie on the ground, without angles they look ahead.
    let piece = |minute: u8, longitude: &str| {
        format!(
            "<gx:Track><when>2010-05-28T02:0{minute}:09Z</when><when>2010-05-28T02:0{minute}:10Z</when>\
             <gx:coord>{longitude}0 37 5</gx:coord><gx:coord>{longitude}1 37 5</gx:coord></gx:Track>"
        )
    };
    let path = parse(&kml(&format!("<gx:MultiTrack>{}{}</gx:MultiTrack>", piece(1, "8.0"), piece(2, "8.1")))).unwrap();
    assert_eq!((path.poses().len(), path.duration(), path.frame()), (4, 61.0, Frame::Earth(Heights::Ground)));
    assert!(near(at(&path, 3), [37.0, 8.11, 0.0]));
    assert!(looks(&path, 0.0).0.distance(DVec3::X) < 1e-3);

    let broken = |from: &str, to: &str| refusal(&kml(&track.replace(from, to)));
    assert!(broken("<when>2010-05-28T02:02:11Z</when>", "").contains("line 4: 2 when and 3 gx:coord"));
    assert!(broken("156", "x").contains("gx:coord `x`; expected a number"));
    assert!(broken("-122.2 37.3 156", "-122.2").contains("expected 3 numbers"));
    assert!(broken("37.3 157", "137.3 157").contains("gx:Track, point 1: a latitude of 137.3"));
    assert!(broken("absolute", "high").contains("altitudeMode `high`"));
    assert!(refusal(&kml("<Point><coordinates>1,2,3</coordinates></Point>")).contains("holds no gx:Track"));
}

#[test]
fn kml_tours_fly_wait_and_jump() {
    let camera = |duration: &str, latitude: f64, heading: f64, tilt: f64| {
        format!(
            "<gx:FlyTo><gx:duration>{duration}</gx:duration><gx:flyToMode>bounce</gx:flyToMode><Camera>\
             <longitude>8</longitude><latitude>{latitude}</latitude><altitude>500</altitude><heading>{heading}</heading>\
             <tilt>{tilt}</tilt><gx:altitudeMode>absolute</gx:altitudeMode></Camera></gx:FlyTo>"
        )
    };
    let look_at = "<gx:FlyTo><gx:duration>3</gx:duration><LookAt><longitude>8</longitude><latitude>47</latitude>\
                   <altitude>400</altitude><heading>90</heading><tilt>60</tilt><range>2000</range>\
                   <altitudeMode>absolute</altitudeMode></LookAt></gx:FlyTo>";
    let playlist = [
        "<gx:Wait><gx:duration>9</gx:duration></gx:Wait>".to_owned(),
        camera("7", 47.0, 0.0, 90.0),
        camera("5", 47.01, 0.0, 0.0),
        "<gx:Wait><gx:duration>2.5</gx:duration></gx:Wait>".to_owned(),
        camera("0", 47.02, 180.0, 45.0),
        look_at.to_owned(),
    ];
    let text = kml(&format!("<gx:Tour><gx:Playlist>{}</gx:Playlist></gx:Tour>", playlist.concat()));
    let path = parse(&text).unwrap();
    let times: Vec<f64> = path.poses().iter().map(|pose| pose.time).collect();
    assert_eq!(times, [0.0, 5.0, 7.5, 7.501, 7.501 + 3.0]);
    assert!(looks(&path, 0.0).0.distance(DVec3::Y) < 1e-9);
    let (ahead, up) = looks(&path, 5.0);
    assert!(ahead.distance(-DVec3::Z) < 1e-9 && up.distance(DVec3::Y) < 1e-9, "down, north on top");
    assert!(path.at(7.5).0 == path.at(5.0).0);
    assert!(looks(&path, 7.501).0.distance(DVec3::new(0.0, -1.0, -1.0).normalize()) < 1e-9);
    // 2 km from its target, which lies ahead; 1 km above it, but for the curvature of 0.24 m.
    let (p, q) = path.at(10.501);
    let target = Geodetic::from_degrees(47.0, 8.0, 400.0).to_ecef();
    assert!((p.distance(target) - 2000.0).abs() < 1e-6);
    assert!((q * -DVec3::Z).distance((target - p).normalize()) < 1e-9);
    assert!((Geodetic::from_ecef(p).unwrap().height - 1400.0 - 0.235).abs() < 0.01, "{:?}", at(&path, 4));
    assert!(has_note(&path, "1 flights of the tour take no time") && has_note(&path, "3 flights stop at their ends"));
    assert!(refusal(&text.replace(">5<", ">-5<")).contains("a gx:duration of -5"));
    assert!(refusal(&text.replace("<range>2000", "<range>1e9")).contains("gx:Tour, step 5: a range of 1000000000"));
    assert!(refusal(&text.replace("<latitude>47.01</latitude>", "")).contains("step 2: a view without latitude"));
    assert!(refusal(&kml("<gx:Tour><gx:FlyTo/></gx:Tour>")).contains("a gx:FlyTo without Camera and LookAt"));
}

/// Two aircraft that fly east side by side, 1 km apart; the second is seen from 10 s before the first.
fn formation() -> String {
    let record = |icao24: &str, second: u32, latitude: f64| {
        let longitude = 8.0 + 0.001 * f64::from(second);
        format!(
            "{{\"timestamp\":{},\"icao24\":\"{icao24}\",\"callsign\":\"{icao24}X\",\"latitude\":{latitude},\
             \"longitude\":{longitude},\"altitude\":10000.0,\"groundspeed\":null,\"squawk\":[7,{{}}]}}",
            1_500_000_000_000_u64 + 1000 * u64::from(second)
        )
    };
    let camera = (10..40).map(|second| record("ABC123", second, 47.0));
    let filmed = (0..50).map(|second| record("def456", second, 47.009));
    format!("[{}]", camera.chain(filmed).collect::<Vec<_>>().join(","))
}

#[test]
fn adsb_aircraft_are_selected_and_aimed_at_each_other() {
    let path = parse(&formation()).unwrap();
    assert_eq!((path.poses().len(), path.frame()), (50, Frame::Earth(Heights::Pressure)));
    assert!(near(at(&path, 0), [47.009, 8.0, 3048.0]));
    assert!(has_note(
        &path,
        "2 aircraft: abc123 (ABC123X, 30 positions), def456 (def456X, 50 positions); def456 taken"
    ));
    assert!(looks(&path, 5.0).0.distance(DVec3::X) < 1e-3);
    let options =
        Options { icao24: Some("abc123".into()), look: Some("other=DEF456".parse().unwrap()), ..Options::default() };
    let path = parse_with(&formation(), &options).unwrap();
    assert_eq!(path.poses().len(), 30);
    let target = Geodetic::from_degrees(47.009, 8.0 + 0.015, 3048.0).to_ecef();
    let (p, q) = path.at(5.0);
    assert!((q * -DVec3::Z).distance((target - p).normalize()) < 1e-9, "{}", looks(&path, 5.0).0);
    assert!(looks(&path, 5.0).0.distance(DVec3::Y) < 1e-3);
    assert!(has_note(&path, "aimed at def456 (def456X, 50 positions) in 30 of 30 poses, 1001 m to 1001 m away"));

    let with = |icao24: &str, look: Option<&str>| {
        let look = look.map(|look| look.parse().unwrap());
        parse_with(&formation(), &Options { icao24: Some(icao24.into()), look, ..Options::default() }).unwrap_err()
    };
    assert!(with("000000", None).contains("no aircraft 000000; expected one of abc123 (ABC123X"));
    assert!(with("abc123", Some("other=abc123")).contains("is the aircraft itself"));
    let given = Options { icao24: Some("a".into()), ..Options::default() };
    assert!(parse_with(GPX, &given).unwrap_err().contains("`--icao24`: t is GPX; expected ADS-B JSON"));
    let given = Options { look: Some("other=a".parse().unwrap()), ..Options::default() };
    assert!(parse_with(GPX, &given).unwrap_err().contains("`--look other`: t is GPX"));
    let given = Options { crs: Some(32632), ..Options::default() };
    assert!(parse_with(GPX, &given).unwrap_err().contains("`--path-crs`: t is GPX"));
}

#[test]
fn adsb_records_may_lack_fields_but_not_lie() {
    let rows = |rows: &str| parse(&format!("[{rows}]"));
    let path = rows(
        "{\"timestamp\":2000,\"icao24\":\"a\",\"latitude\":1,\"longitude\":2,\"altitude\":null,\"geoaltitude\":100},\
         {\"timestamp\":1000,\"icao24\":\"a\",\"latitude\":1,\"longitude\":2.1,\"altitude\":40,\"geoaltitude\":90},\
         {\"timestamp\":1000,\"icao24\":\"a\",\"latitude\":1,\"longitude\":2.2,\"geoaltitude\":90},\
         {\"timestamp\":null,\"icao24\":\"a\"}",
    )
    .unwrap();
    assert_eq!((path.poses().len(), path.frame()), (2, Frame::Earth(Heights::Ellipsoid)));
    assert!(near(at(&path, 0), [1.0, 2.1, 90.0 * 0.3048]), "{:?}", at(&path, 0));
    assert!(
        has_note(&path, "put in order of time") && has_note(&path, "1 of 3 positions have the time of the one before")
    );
    assert!(has_note(&path, "on average +15.2 m against the pressure altitude"));
    assert!(has_note(&path, "1 records of a without time or position"));
    // Whole seconds give way to the times of reception.
    let received = "{\"timestamp\":1000,\"icao24\":\"a\",\"latitude\":1,\"longitude\":2,\"last_position\":250},\
                    {\"timestamp\":2000,\"icao24\":\"a\",\"latitude\":1,\"longitude\":3,\"last_position\":1750}";
    assert_eq!(rows(received).unwrap().duration(), 1.5);
    assert_eq!(rows(&received.replace(":1750", ":null")).unwrap().duration(), 1.0);
    let refused = |text: &str| rows(text).map(|_| ()).unwrap_err();
    let good = "{\"timestamp\":1,\"icao24\":\"a\",\"latitude\":1,\"longitude\":2}";
    assert!(refused(&format!("{good},{{\"timestamp\":\"x\"}}")).contains("t, [1]: invalid type: string"));
    assert!(refused(&format!("{good},{{\"timestamp\":1}}")).contains("t, [1]: a record without icao24"));
    assert!(refused(&format!("{good},{}", good.replace(":2", ":1e9"))).contains("position 1 of a: a longitude of"));
    assert!(refused("").contains("holds no record"));
    assert!(refusal("{\"records\":[]}").contains("[0]: invalid type: map, expected a list of records"));
    assert!(refusal(&format!("[{good}] x")).contains("trailing characters"));
    assert!(refusal("[{\"timestamp\":").contains("[0]: EOF while parsing"));
    assert!(refusal(&format!("[{}", "{\"a\":".repeat(100_000))).contains("EOF"));
}

fn gzip(content: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
    encoder.write_all(content).unwrap();
    encoder.finish().unwrap()
}

#[test]
fn compressed_content_is_recognised_and_limited() {
    let options = Options::default();
    let plain = parse(&formation()).unwrap();
    let compressed = gzip(formation().as_bytes());
    assert_eq!(from_bytes("t", &compressed, &options).unwrap().hash(), plain.hash());
    assert_eq!(from_bytes("t", &gzip(GPX.as_bytes()), &options).unwrap().hash(), parse(GPX).unwrap().hash());
    let cut = from_bytes("t", &compressed[..compressed.len() / 2], &options).unwrap_err().to_string();
    assert!(cut.contains("t: gzip: "), "{cut}");
    let bomb = gzip(&vec![b' '; 8 << 20]);
    let refused = from_bytes("t", &bomb, &options).unwrap_err().to_string();
    assert!(refused.contains("expected at most that decompressed"), "{refused}");
}

fn npy(shape: &str, values: &[f64]) -> Vec<u8> {
    let mut header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}").into_bytes();
    header.resize(117, b' ');
    header.push(b'\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header);
    bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    bytes
}

#[test]
fn arrays_of_comma2k19() {
    // Two poses on the equator at the zero meridian: +x is up there, +y east, +z north. A device that looks north with
    // its +z down has its x axis along +z and its z axis along −x.
    let q = glam::DQuat::from_mat3(&glam::DMat3::from_cols(DVec3::Z, DVec3::Y, -DVec3::X));
    let quaternion = [q.w, q.x, q.y, q.z];
    let r = 6_378_137.0;
    let arrays = [
        npy("(2,)", &[5.0, 6.0]),
        npy("(2, 3)", &[r, 0.0, 0.0, r, 0.0, 10.0]),
        npy("(2, 4)", &[quaternion, quaternion].concat()),
    ];
    let read = |arrays: &[Vec<u8>; 3]| {
        let [a, b, c] = arrays;
        from_arrays("t", [a, b, c], &Options::default()).map_err(|error| error.to_string())
    };
    let path = read(&arrays).unwrap();
    assert_eq!((path.duration(), path.frame()), (1.0, Frame::Earth(Heights::Ellipsoid)));
    let (ahead, up) = looks(&path, 0.0);
    assert!(ahead.distance(DVec3::Y) < 1e-12 && up.distance(DVec3::Z) < 1e-12, "{ahead} {up}");
    assert!(has_note(&path, "forward follows the motion by 1.00, up the vertical by 1.00"));
    let swapped = |index: usize, bytes: Vec<u8>| {
        let mut arrays = arrays.clone();
        arrays[index] = bytes;
        read(&arrays).map(|_| ()).unwrap_err()
    };
    assert!(swapped(1, npy("(2, 4)", &[0.0; 8])).contains("t, frame_positions.npy: 4 columns; expected 3"));
    assert!(swapped(1, npy("(2, 3)", &[0.0; 6])).contains("row 0"));
    assert!(swapped(1, npy("(2, 3)", &[f64::NAN; 6])).contains("row 0"));
    assert!(swapped(0, npy("(3,)", &[0.0; 3])).contains("3 times, 2 positions, 2 orientations"));
    assert!(swapped(0, npy("(2,)", &[0.0])).contains("byte 128: 8 bytes of data; expected 2 × 1 × 8"));
    assert!(swapped(0, npy("(99999999999999999,)", &[0.0])).contains("bytes of data"));
    assert!(swapped(0, npy("(2, 3, 4)", &[0.0])).contains("shape"));
    assert!(swapped(0, b"\x93NUMPY\x09".to_vec()).contains("ends within the header"));
    assert!(swapped(2, npy("(2, 4)", &[0.0; 8])).contains("row 0: a quaternion of length 0"));
    let one = from_bytes("t", &arrays[0], &Options::default()).unwrap_err().to_string();
    assert!(one.contains("is one NumPy array; expected a folder"), "{one}");
}

#[test]
fn tables_of_positions_and_bitrates() {
    let header = "Timestamp,Longitude,Latitude,Speed,DL_bitrate\n";
    let rows = "2019.12.16_23.59.58,-8.40,51.9,36,5\n2019.12.16_23.59.58,-8.41,51.9,36,5\n\
                2019.12.16_23.59.59,-8.40,51.9,36,5\n2019.12.17_00.00.00,-,-,36,5\n\
                2019.12.17_00.00.08,-8.39,51.9,0,5\n2019.12.17_00.00.09,-8.39,51.9,0,5\n";
    let path = parse(&format!("{header}{rows}")).unwrap();
    let times: Vec<f64> = path.poses().iter().map(|pose| pose.time).collect();
    assert_eq!((times.as_slice(), path.frame()), ([0.0, 10.0, 11.0].as_slice(), Frame::Earth(Heights::Ground)));
    assert!(near(at(&path, 1), [51.9, -8.39, 0.0]));
    assert!(has_note(&path, "1 of 6 rows have the time of the row before"));
    assert!(has_note(&path, "1 of 6 rows repeat the last position while moving"));
    assert!(has_note(&path, "1 of 6 rows without position") && has_note(&path, "no heights"));
    assert!(looks(&path, 11.0).0.distance(DVec3::X) < 1e-3, "at rest the last direction is kept");
    assert!(refusal(&format!("{header}2019.13.16_00.00.00,1,2,3,4\n")).contains("line 2: time `2019.13.16_00.00.00`"));
    assert!(refusal(&format!("{header}2019.12.16_00.00.00,x,2,3,4\n")).contains("line 2: longitude `x`"));
    assert!(refusal(&format!("{header}2019.12.16_00.00.00,1,92,3,4\n")).contains("line 2: a latitude of 92"));
    assert!(refusal(&format!("{header}2019.12.16_00.00.00,1\n")).contains("line 2: 2 columns; expected a column 3"));
    assert!(refusal(header).contains("at least 2 poses"));
}

#[test]
fn recorded_paths_on_the_earth_are_what_is_known_of_them() {
    let (Some(paths), Some(network)) = (data("paths"), data("network")) else { return };
    // File, poses, seconds, heights, least latitude and longitude to a thousandth of a degree, traps by their notes.
    type Known<'a> = (&'a str, usize, f64, Heights, [f64; 2], &'a [&'a str]);
    let known: [Known<'_>; 9] = [
        ("aircraft_dreamliner_airfrance.json.gz", 13143, 13142.0, Heights::Pressure, [43.257, 2.061], &["2 aircraft"]),
        (
            "aircraft_rega_zh.json.gz",
            337,
            338.2,
            Heights::Ellipsoid,
            [47.363, 8.501],
            &["+70.4 m against the pressure"],
        ),
        (
            "aircraft_zero_gravity.json.gz",
            10367,
            10366.0,
            Heights::Pressure,
            [44.772, -3.484],
            &["as the ground speed"],
        ),
        ("drive_comma2k19_highway", 1200, 59.949, Heights::Ellipsoid, [37.721, -122.472], &["wxyz"]),
        ("glide_skydrop-2019-04-15.igc", 533, 538.0, Heights::SeaLevel, [45.807, 11.763], &["+80.3 m against"]),
        ("glide_skytraxx21-2023-04-15.igc", 2008, 2007.0, Heights::Ellipsoid, [36.553, 31.970], &["+59.2 m against"]),
        ("hike_korita_zbevnica.gpx", 513, 13381.0, Heights::SeaLevel, [45.451, 14.004], &["358 of 871 track points"]),
        ("irish5g_driving_B_2019.12.16_07.22.43.csv", 200, 2556.0, Heights::Ground, [51.897, -8.483], &["334 of 2617"]),
        ("irish5g_static_B_2020.02.14_13.21.26.csv", 939, 1102.0, Heights::Ground, [51.886, -8.395], &["74 of 1013"]),
    ];
    for (file, poses, duration, heights, corner, notes) in known {
        let folder = if file.starts_with("irish5g") { &network } else { &paths };
        let path = from_file(&folder.join(file), &Options::default()).unwrap();
        let facts = PathFacts::new(&path);
        println!("{file}: {:#?} {:?}", facts.lines(), path.notes());
        assert_eq!((facts.poses, path.frame()), (poses, Frame::Earth(heights)), "{file}");
        assert!((facts.duration - duration).abs() < 1e-3, "{file}: {}", facts.duration);
        let place = facts.place.unwrap();
        assert!((place.latitude[0] - corner[0]).abs() < 1e-3 && (place.longitude[0] - corner[1]).abs() < 1e-3);
        for note in notes {
            assert!(has_note(&path, note), "{file}: {note}: {:?}", path.notes());
        }
        for pose in path.poses().iter().step_by(7) {
            assert!(pose.position.is_finite() && pose.orientation.is_normalized());
        }
    }
    let drive = paths.join("drive_comma2k19_highway");
    assert!(is_path_like(&drive) && !is_path_like(&paths));
    let by_file = from_file(&drive.join("frame_positions.npy"), &Options::default()).unwrap();
    let by_folder = from_file(&drive, &Options::default()).unwrap();
    assert_eq!(by_file.hash(), by_folder.hash());
    assert!(has_note(&by_folder, "forward follows the motion by 1.00, up the vertical by 1.00"));
    // 20 Hz from 37.721° north, 122.472° west; the README's 50 to 60 km/h.
    let hike = from_file(&paths.join("hike_korita_zbevnica.gpx"), &Options::default()).unwrap();
    assert!(PathFacts::new(&hike).traps.iter().any(|trap| trap.contains("irregular: from 7.000 s to 2041.000 s")));
}

#[test]
fn one_aircraft_films_another() {
    let Some(paths) = data("paths") else { return };
    let options =
        Options { icao24: Some("3900fb".into()), look: Some("other=39c424".parse().unwrap()), ..Options::default() };
    let path = from_file(&paths.join("aircraft_dreamliner_airfrance.json.gz"), &options).unwrap();
    assert_eq!(path.poses().len(), 4767);
    println!("{:?}", path.notes());
    assert!(has_note(&path, "in 4767 of 4767 poses"), "{:?}", path.notes());
}

#[test]
fn a_survey_in_utm_is_put_on_the_earth() {
    let Some(paths) = data("paths") else { return };
    let file = paths.join("survey_georeferenced_utm.tum");
    let local = from_file(&file, &Options::default()).unwrap();
    assert!(PathFacts::new(&local).traps.iter().any(|trap| trap.contains("a projected system")));
    let path = from_file(&file, &Options { crs: Some(32632), ..Options::default() }).unwrap();
    let facts = PathFacts::new(&path);
    assert_eq!(facts.place.unwrap().utm, 32632);
    let [south, north] = facts.place.unwrap().latitude;
    assert!(south > 49.01 && north < 49.02, "{:?}", facts.place);
    // The grid's scale at 42 km from the central meridian, 0.9996 (1 + 42² / (2 · 6380²)), 163 m above the ellipsoid.
    let scale = PathFacts::new(&local).length / facts.length;
    assert!((scale - 0.999_622 * (1.0 - 163.0 / 6.38e6)).abs() < 2e-5, "{scale}");
    assert!((facts.height[0] - PathFacts::new(&local).height[0]).abs() < 1e-6);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn no_bytes_make_them_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200), cut in 0.0..1.0f64, at in 0.0..1.0f64) {
        let formats = [Format::Gpx, Format::Igc, Format::Kml, Format::AdsB, Format::Irish5g];
        for format in formats {
            let _ = from_bytes_as(format, "t", &bytes, &Options::default());
        }
        // A good file with a piece replaced.
        let sources = [GPX.as_bytes().to_vec(), formation().into_bytes(), npy("(2,)", &[0.0, 1.0])];
        for mut source in sources {
            let from = (at * source.len() as f64) as usize;
            let to = (from + (cut * 40.0) as usize).min(source.len());
            source.splice(from..to, bytes.iter().copied().take(20));
            let _ = from_bytes("t", &source, &Options::default());
            let _ = from_arrays("t", [&source, &source, &source], &Options::default());
        }
    }
}
