use std::io::{Cursor, Write};
use std::path::PathBuf;

use foresight_scheduler::lod_tree::RepId;
use glam::DVec3;
use tiff::encoder::{Compression, TiffEncoder, colortype};
use tiff::tags::Tag;
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

use super::*;

/// Folder of recorded data; `None`, with a line that says so, where it is absent.
fn data() -> Option<PathBuf> {
    let folder = match std::env::var_os("FORESIGHT_DATA") {
        Some(folder) => PathBuf::from(folder),
        None => Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"),
    };
    if folder.is_dir() {
        return Some(folder);
    }
    assert!(std::env::var_os("CI").is_none_or(|value| value != "true"), "no test data at {}", folder.display());
    println!("skipped: no test data at {}", folder.display());
    None
}

fn npy(descr: &str, shape: &str, fortran: bool, data: &[u8]) -> Vec<u8> {
    let order = if fortran { "True" } else { "False" };
    let mut header = format!("{{'descr': '{descr}', 'fortran_order': {order}, 'shape': {shape}, }}");
    while (10 + header.len() + 1) % 64 != 0 {
        header.push(' ');
    }
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend_from_slice(&(header.len() as u16).to_le_bytes());
    bytes.extend_from_slice(header.as_bytes());
    bytes.extend_from_slice(data);
    bytes
}

fn npz(members: &[(&str, Vec<u8>)]) -> Vec<u8> {
    let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in members {
        writer.start_file(format!("{name}.npy"), SimpleFileOptions::default()).unwrap();
        writer.write_all(bytes).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

fn scalar(value: f64) -> Vec<u8> {
    npy("<f8", "()", false, &value.to_le_bytes())
}

fn extent(x: [f64; 2], y: [f64; 2]) -> Vec<(&'static str, Vec<u8>)> {
    vec![("xmin", scalar(x[0])), ("xmax", scalar(x[1])), ("ymin", scalar(y[0])), ("ymax", scalar(y[1]))]
}

fn elevation(kind: &str, fortran: bool, data: &[u8]) -> Vec<u8> {
    let mut members = extent([0.0, 300.0], [0.0, 200.0]);
    members.push(("elevation", npy(kind, "(2, 3)", fortran, data)));
    npz(&members)
}

#[test]
fn every_number_type_and_order_gives_the_same_grid() {
    let values = [1_i16, -2, 3, 4, 5, -600];
    let by_column = [1_i16, 4, -2, 5, 3, -600];
    let bytes =
        |values: &[i16], to: &dyn Fn(i16) -> Vec<u8>| values.iter().flat_map(|&value| to(value)).collect::<Vec<u8>>();
    let expected = parse_npz(&elevation("<i2", false, &bytes(&values, &|v| v.to_le_bytes().to_vec()))).unwrap();
    assert_eq!(expected.heights, [1.0, -2.0, 3.0, 4.0, 5.0, -600.0]);
    assert_eq!(
        (expected.origin, expected.column, expected.row),
        (DVec2::new(50.0, 150.0), DVec2::new(100.0, 0.0), DVec2::new(0.0, -100.0))
    );
    assert_eq!(expected.coordinates, Coordinates::Metres);
    let others = [
        elevation(">i2", false, &bytes(&values, &|v| v.to_be_bytes().to_vec())),
        elevation("<i2", true, &bytes(&by_column, &|v| v.to_le_bytes().to_vec())),
        elevation("<i8", false, &bytes(&values, &|v| i64::from(v).to_le_bytes().to_vec())),
        elevation("<f4", false, &bytes(&values, &|v| f32::from(v).to_le_bytes().to_vec())),
        elevation(">f8", false, &bytes(&values, &|v| f64::from(v).to_be_bytes().to_vec())),
    ];
    for other in others {
        assert_eq!(parse_npz(&other).unwrap(), expected);
    }
}

#[test]
fn the_step_tells_cells_from_points() {
    let grid = |dx: f64| {
        let mut members = extent([0.0, 300.0], [200.0, 0.0]);
        members.extend([("dx", scalar(dx)), ("z", npy("|u1", "(2, 3)", false, &[1, 2, 3, 4, 5, 6]))]);
        parse_npz(&npz(&members))
    };
    assert_eq!(grid(100.0).unwrap().origin.x, 50.0);
    assert_eq!(grid(-150.0).unwrap().origin.x, 0.0);
    assert_eq!(grid(150.0).unwrap().notes.len(), 2, "ymin above ymax is said");
    let message = grid(80.0).unwrap_err().to_string();
    assert!(message.contains("dx.npy: 80; expected the extent 300 over the 3 samples"), "{message}");
}

#[test]
fn refuses_arrays_at_fault() {
    let with = |array: Vec<u8>| {
        let mut members = extent([0.0, 300.0], [0.0, 200.0]);
        members.push(("elevation", array));
        parse_npz(&npz(&members)).unwrap_err().to_string()
    };
    for (array, part) in [
        (npy("<c8", "(2, 3)", false, &[0; 48]), "elements of type"),
        (npy("<f4", "(2, 3)", false, &[0; 23]), "expected 6 elements of 4 bytes"),
        (npy("<f4", "(4294967295, 4294967295)", false, &[]), "expected at most"),
        (npy("<f4", "(2, 3, 1)", false, &[0; 24]), "expected rows and columns"),
        (npy("<f4", "(-2, 3)", false, &[0; 24]), "expected rows and columns"),
        (b"\x93NUMPY\x09\x00".to_vec(), "version 9"),
        (b"\x93NUM".to_vec(), "expected a numpy array"),
        (scalar(3.0), "no array of two dimensions"),
    ] {
        let message = with(array);
        assert!(message.contains(part), "{message}");
    }
    assert!(parse_npz(b"PK\x03\x04").unwrap_err().to_string().contains("expected a zip archive"));
    let grid = npy("<f4", "(2, 3)", false, &[0; 24]);
    let message = parse_npz(&npz(&[("elevation", grid)])).unwrap_err().to_string();
    assert!(message.contains("xmin.npy: not there"), "{message}");
}

#[test]
fn the_jacksboro_fault() {
    let Some(data) = data() else { return };
    let world = crate::world::open(&data.join("scenes/jacksboro_fault_dem.npz")).unwrap();
    let summary = world.summary();
    // 402 × 343 cells: 7 × 6 tiles, 4 × 3, 2 × 2, 1.
    assert_eq!(summary.representations, 42 + 12 + 4 + 1);
    assert_eq!(world.georeference, Some(Georeference::Epsg(32616)));
    assert!(world.notes.iter().any(|note| note.text.contains("ymin 36.73")), "{:?}", world.notes);
    let size = summary.bounds.max - summary.bounds.min;
    // 402 × 3″ at 36.6° N by 343 × 3″.
    assert!((size.x - 30_300.0).abs() < 1000.0 && (size.y - 32_000.0).abs() < 1000.0, "{size}");
    assert!(size.z > 500.0 && size.z < 1500.0, "{size}");
    assert!(world.tree.error(RepId(0)) > 50.0 && world.tree.error(RepId(3)) == 0.0);
    let middle = world.ground_height(summary.bounds.centre()).unwrap();
    assert!((summary.bounds.min.z..=summary.bounds.max.z).contains(&middle));
    assert_eq!(world.ground_height(DVec3::NAN), None);
}

struct Tags<'a> {
    scale: &'a [f64],
    tie: &'a [f64],
    matrix: &'a [f64],
    keys: &'a [u16],
    nodata: &'a str,
}

const UTM: Tags<'static> = Tags {
    scale: &[10.0, 20.0, 0.0],
    tie: &[0.0, 0.0, 0.0, 500_000.0, 5_000_000.0, 0.0],
    matrix: &[],
    keys: &[1, 1, 0, 3, 1024, 0, 1, 1, 1025, 0, 1, 1, 3072, 0, 1, 32632],
    nodata: "-32768",
};

fn geotiff<C: colortype::ColorType>(tags: &Tags<'_>, compression: Compression, values: &[C::Inner]) -> Vec<u8>
where
    [C::Inner]: tiff::encoder::TiffValue,
{
    let mut bytes = Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut bytes).unwrap().with_compression(compression);
    let mut image = encoder.new_image::<C>(3, 2).unwrap();
    let directory = image.encoder();
    for (tag, numbers) in [
        (Tag::ModelPixelScaleTag, tags.scale),
        (Tag::ModelTiepointTag, tags.tie),
        (Tag::ModelTransformationTag, tags.matrix),
    ] {
        if !numbers.is_empty() {
            directory.write_tag(tag, numbers).unwrap();
        }
    }
    directory.write_tag(Tag::GeoKeyDirectoryTag, tags.keys).unwrap();
    directory.write_tag(Tag::GdalNodata, tags.nodata).unwrap();
    image.write_data(values).unwrap();
    bytes.into_inner()
}

#[test]
fn strips_of_every_type_and_compression() {
    let expected = [1.0, 2.0, 3.0, 4.0, 5.0];
    let check = |bytes: Vec<u8>| {
        let grid = parse_geotiff(&bytes).unwrap();
        assert_eq!(grid.heights[..5], expected);
        assert!(grid.heights[5].is_nan(), "{:?}", grid.heights);
        assert_eq!(
            (grid.origin, grid.coordinates),
            (DVec2::new(500_005.0, 4_999_990.0), Coordinates::Projected(32632))
        );
        assert_eq!((grid.column, grid.row), (DVec2::new(10.0, 0.0), DVec2::new(0.0, -20.0)));
    };
    let (integers, floats) = ([1, 2, 3, 4, 5, -32768], [1.0, 2.0, 3.0, 4.0, 5.0, -32768.0]);
    for compression in [Compression::Uncompressed, Compression::Lzw, Compression::Deflate(Default::default())] {
        check(geotiff::<colortype::GrayI16>(&UTM, compression, &integers));
        check(geotiff::<colortype::Gray32Float>(&UTM, compression, &floats));
        check(geotiff::<colortype::Gray64Float>(&UTM, compression, &floats.map(f64::from)));
    }
}

#[test]
fn tiles_of_a_tiled_image() {
    // 20 × 18 samples in four tiles of 16 × 16, written by hand: little-endian, uncompressed, 16-bit.
    let (columns, rows, side) = (20_u32, 18_u32, 16_u32);
    let height = |x: u32, y: u32| if x < columns && y < rows { (100 * y + x) as i16 } else { 0 };
    let mut file = b"II*\0\0\0\0\0".to_vec();
    let mut offsets = Vec::new();
    for (tile_x, tile_y) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
        offsets.push(file.len() as u32);
        for y in 0..side {
            for x in 0..side {
                file.extend_from_slice(&height(tile_x * side + x, tile_y * side + y).to_le_bytes());
            }
        }
    }
    let mut array = |values: &[u8]| {
        let at = file.len() as u32;
        file.extend_from_slice(values);
        at
    };
    let words = |values: &[u32]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
    let doubles = |values: &[f64]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
    let offsets_at = array(&words(&offsets));
    let counts_at = array(&words(&[512; 4]));
    let matrix_at = array(&doubles(&[0.0, 2.0, 0.0, 7.0, 3.0, 0.0, 0.0, 9.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]));
    let directory_at = file.len() as u32;
    let entries: [(u16, u16, u32, u32); 12] = [
        (256, 4, 1, columns),
        (257, 4, 1, rows),
        (258, 3, 1, 16),
        (259, 3, 1, 1),
        (262, 3, 1, 1),
        (277, 3, 1, 1),
        (322, 4, 1, side),
        (323, 4, 1, side),
        (324, 4, 4, offsets_at),
        (325, 4, 4, counts_at),
        (339, 3, 1, 2),
        (34264, 12, 16, matrix_at),
    ];
    file.extend_from_slice(&(entries.len() as u16).to_le_bytes());
    for (tag, kind, count, value) in entries {
        file.extend_from_slice(&tag.to_le_bytes());
        file.extend_from_slice(&kind.to_le_bytes());
        file.extend_from_slice(&count.to_le_bytes());
        file.extend_from_slice(&value.to_le_bytes());
    }
    file.extend_from_slice(&[0; 4]);
    file[4..8].copy_from_slice(&directory_at.to_le_bytes());
    let grid = parse_geotiff(&file).unwrap();
    let expected: Vec<f32> = (0..rows).flat_map(|y| (0..columns).map(move |x| f32::from(height(x, y)))).collect();
    assert_eq!(grid.heights, expected);
    // A transformation that exchanges the axes; pixels are areas.
    assert_eq!(
        (grid.column, grid.row, grid.origin),
        (DVec2::new(0.0, 3.0), DVec2::new(2.0, 0.0), DVec2::new(8.0, 10.5))
    );
    assert_eq!(grid.coordinates, Coordinates::Metres);
}

#[test]
fn degrees_become_utm_and_points_stay_points() {
    let degrees = Tags {
        scale: &[0.001, 0.001, 0.0],
        tie: &[1.0, 1.0, 0.0, 9.0, 47.0, 0.0],
        keys: &[1, 1, 0, 3, 1024, 0, 1, 2, 1025, 0, 1, 2, 2048, 0, 1, 4269],
        ..UTM
    };
    let bytes = geotiff::<colortype::Gray32Float>(&degrees, Compression::Uncompressed, &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0]);
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("h.tif");
    std::fs::write(&file, bytes).unwrap();
    let world = crate::world::open(&file).unwrap();
    assert_eq!(world.georeference, Some(Georeference::Epsg(32632)));
    // The tie point: column 1 of row 1 lies on the zone's central meridian, easting 500 km.
    let tie = Projection::from_epsg(32632).unwrap().forward(Geodetic::from_degrees(47.0, 9.0, 0.0)).unwrap();
    assert!((tie.x - 500_000.0).abs() < 1e-3);
    let height = world.ground_height(tie).unwrap();
    assert!((height - 4.0).abs() < 1e-3, "{height}");
    assert!(world.notes.iter().any(|note| note.text.contains("4269: taken as WGS 84")), "{:?}", world.notes);
    let bounds = world.summary().bounds;
    assert!((bounds.max.x - bounds.min.x - 152.0).abs() < 2.0 && (bounds.max.y - bounds.min.y - 111.2).abs() < 2.0);
}

#[test]
fn refuses_geotiffs_at_fault() {
    let refusal = |tags: Tags<'_>| {
        let bytes = geotiff::<colortype::GrayI16>(&tags, Compression::Uncompressed, &[1, 2, 3, 4, 5, 6]);
        parse_geotiff(&bytes).unwrap_err().to_string()
    };
    assert!(refusal(Tags { scale: &[], ..UTM }).contains("ModelPixelScale: not there"));
    assert!(refusal(Tags { tie: &[0.0; 12], ..UTM }).contains("ModelTiepoint: 12 numbers"));
    assert!(refusal(Tags { matrix: &[0.0; 3], ..UTM }).contains("ModelTransformation: 3 numbers"));
    assert!(refusal(Tags { keys: &[2, 1, 0, 0], ..UTM }).contains("version 2"));
    assert!(refusal(Tags { keys: &[1, 1, 0, 1, 1024, 0, 1, 3], ..UTM }).contains("model type 3"));
    assert!(
        refusal(Tags { keys: &[1, 1, 0, 1, 4099, 0, 1, 9002], ..UTM }).contains("vertical units of EPSG code 9002")
    );
    let colour = {
        let mut bytes = Cursor::new(Vec::new());
        let mut encoder = TiffEncoder::new(&mut bytes).unwrap();
        encoder.write_image::<colortype::RGB8>(2, 2, &[0; 12]).unwrap();
        bytes.into_inner()
    };
    assert!(parse_geotiff(&colour).unwrap_err().to_string().contains("expected one band of heights"));
    let whole = geotiff::<colortype::GrayI16>(&UTM, Compression::Deflate(Default::default()), &[1, 2, 3, 4, 5, 6]);
    for length in 0..whole.len() {
        let _ = parse_geotiff(&whole[..length]);
    }
}
