//! What an image's planes cost by codec: bytes against what is lost, and the time.

use std::io::Write;

use flate2::write::DeflateEncoder;
use foresight_index::format::orthoview::{Planes, planes};
use foresight_index::format::prediction::predicted;
use foresight_index::orthoview::connectivity::{Thresholds, links};
use foresight_index::orthoview::{Direction, Orthoview};
use foresight_sim::stopwatch::Stopwatch;
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::codecs::webp::WebPEncoder;
use image::{ExtendedColorType, ImageEncoder, ImageFormat};
use rayon::prelude::*;
use serde_json::json;

use super::scene::Scene;
use super::table::Table;
use super::{Fault, Findings};

/// An image to be kept.
pub struct Sample {
    planes: Planes,
}

/// Images of a scene, of all levels and directions: of the cells of each level every n-th, so that there are about `most`
/// cells a level.
///
/// # Errors
/// A content that cannot be read.
pub fn samples(scene: &Scene, most: usize) -> Result<Vec<Sample>, Fault> {
    let mut taken: std::collections::BTreeMap<u32, usize> = std::collections::BTreeMap::new();
    let mut samples = Vec::new();
    let counts: Vec<usize> = (0..=scene.octree.root().level).map(|l| scene.cells(l).len()).collect();
    scene.orthoviews(&scene.directions, |cell, images: &[(Direction, &Orthoview)]| {
        let seen = taken.entry(cell.level).or_default();
        *seen += 1;
        let step = counts[cell.level as usize].div_ceil(most.max(1));
        if (*seen - 1).is_multiple_of(step) {
            let made = images.par_iter().filter_map(|(direction, view)| {
                let links = links(view, &scene.lattice(*direction), &Thresholds::default());
                Some(Sample { planes: planes(view, &links)? })
            });
            samples.par_extend(made);
        }
        Ok(())
    })?;
    Ok(samples)
}

/// What a codec made of a plane.
struct Coded {
    bytes: usize,
    /// As it was read again; `None` for a codec that loses nothing.
    again: Option<Vec<u8>>,
    nanos: u64,
}

type Coder<'a> = Box<dyn Fn(&Planes) -> Coded + Sync + 'a>;

fn timed(encode: impl FnOnce() -> Vec<u8>) -> (Vec<u8>, u64) {
    let watch = Stopwatch::start();
    let bytes = encode();
    (bytes, watch.nanos())
}

fn size(planes: &Planes) -> (u32, u32) {
    (planes.rect.width() as u32, planes.rect.height() as u32)
}

/// A whole image into memory cannot fail.
fn whole(result: image::ImageResult<()>) {
    debug_assert!(result.is_ok(), "{result:?}");
}

fn png(data: &[u8], (width, height): (u32, u32), kind: ExtendedColorType) -> Vec<u8> {
    let mut out = Vec::new();
    let encoder = PngEncoder::new_with_quality(&mut out, CompressionType::Default, FilterType::Adaptive);
    whole(encoder.write_image(data, width, height, kind));
    out
}

fn webp_lossless(rgb: &[u8], (width, height): (u32, u32)) -> Vec<u8> {
    let mut out = Vec::new();
    whole(WebPEncoder::new_lossless(&mut out).write_image(rgb, width, height, ExtendedColorType::Rgb8));
    out
}

fn webp_lossy(rgb: &[u8], (width, height): (u32, u32), quality: f32) -> Vec<u8> {
    webp::Encoder::from_rgb(rgb, width, height).encode(quality).to_vec()
}

/// By libwebp, which searches longer than the encoder in Rust.
fn libwebp_lossless(rgb: &[u8], (width, height): (u32, u32)) -> Vec<u8> {
    webp::Encoder::from_rgb(rgb, width, height).encode_lossless().to_vec()
}

fn libwebp_sharp(rgb: &[u8], (width, height): (u32, u32), quality: f32) -> Vec<u8> {
    let Ok(mut config) = webp::WebPConfig::new() else { return Vec::new() };
    (config.quality, config.use_sharp_yuv) = (quality, 1);
    webp::Encoder::from_rgb(rgb, width, height).encode_advanced(&config).map_or_else(|_| Vec::new(), |m| m.to_vec())
}

/// Each byte less the one `channels` before it, a channel after the other.
fn differences(data: &[u8], channels: usize, width: usize) -> Vec<u8> {
    let row = channels * width.max(1);
    let off = |i: usize| {
        let before = if i % row >= channels {
            data[i - channels]
        } else if i >= row {
            data[i - row]
        } else {
            0
        };
        data[i].wrapping_sub(before)
    };
    (0..channels).flat_map(|c| (c..data.len()).step_by(channels).map(off)).collect()
}

fn jpeg(rgb: &[u8], (width, height): (u32, u32), quality: u8) -> Vec<u8> {
    let mut out = Vec::new();
    whole(JpegEncoder::new_with_quality(&mut out, quality).encode(rgb, width, height, ExtendedColorType::Rgb8));
    out
}

fn again(bytes: &[u8], format: ImageFormat) -> Vec<u8> {
    image::load_from_memory_with_format(bytes, format).map(|i| i.into_rgb8().into_raw()).unwrap_or_default()
}

fn deflate(data: &[u8]) -> Vec<u8> {
    let mut encoder = DeflateEncoder::new(Vec::new(), flate2::Compression::new(9));
    let written = encoder.write_all(data).and_then(|()| encoder.finish());
    written.unwrap_or_default()
}

fn zstd(data: &[u8]) -> Vec<u8> {
    zstd::bulk::compress(data, 19).unwrap_or_default()
}

/// Two channels as three, the third 0, for codecs of three.
fn padded(two: &[u8]) -> Vec<u8> {
    two.as_chunks::<2>().0.iter().flat_map(|&[a, b]| [a, b, 0]).collect()
}

/// The codes of the depths, low bytes before high ones.
fn codes(planes: &Planes) -> Vec<u8> {
    let codes = predicted(&planes.depths, planes.rect.width());
    codes.iter().map(|v| *v as u8).chain(codes.iter().map(|v| (v >> 8) as u8)).collect()
}

fn packed(planes: &Planes) -> Vec<u16> {
    planes.depths.iter().zip(&planes.links).map(|(d, l)| d << 6 | u16::from(*l)).collect()
}

fn native(samples: &[u16]) -> Vec<u8> {
    samples.iter().flat_map(|v| v.to_ne_bytes()).collect()
}

fn lossless(encode: impl Fn(&Planes) -> Vec<u8> + Sync + 'static) -> Coder<'static> {
    Box::new(move |planes| {
        let (bytes, nanos) = timed(|| encode(planes));
        Coded { bytes: bytes.len(), again: None, nanos }
    })
}

fn lossy(
    encode: impl Fn(&Planes) -> Vec<u8> + Sync + 'static,
    decode: impl Fn(&[u8]) -> Vec<u8> + Sync + 'static,
) -> Coder<'static> {
    Box::new(move |planes| {
        let (bytes, nanos) = timed(|| encode(planes));
        Coded { bytes: bytes.len(), again: Some(decode(&bytes)), nanos }
    })
}

fn colour_coders() -> Vec<(String, Coder<'static>)> {
    let mut coders = vec![
        ("PNG".to_owned(), lossless(|p| png(&p.colours, size(p), ExtendedColorType::Rgb8))),
        ("WebP lossless".to_owned(), lossless(|p| webp_lossless(&p.colours, size(p)))),
    ];
    for quality in [50u8, 75, 85, 90, 95] {
        let encode = move |p: &Planes| jpeg(&p.colours, size(p), quality);
        coders.push((format!("JPEG {quality}"), lossy(encode, |b| again(b, ImageFormat::Jpeg))));
    }
    coders.push(("WebP lossless, libwebp".to_owned(), lossless(|p| libwebp_lossless(&p.colours, size(p)))));
    for quality in [75u8, 85, 95] {
        let encode = move |p: &Planes| libwebp_sharp(&p.colours, size(p), f32::from(quality));
        coders.push((format!("WebP {quality}, sharp chroma"), lossy(encode, |b| again(b, ImageFormat::WebP))));
    }
    for quality in [50u8, 75, 85, 90, 95] {
        let encode = move |p: &Planes| webp_lossy(&p.colours, size(p), f32::from(quality));
        coders.push((format!("WebP {quality}"), lossy(encode, |b| again(b, ImageFormat::WebP))));
    }
    coders
}

fn normal_coders() -> Vec<(String, Coder<'static>)> {
    let two = |bytes: Vec<u8>| bytes.as_chunks::<3>().0.iter().flat_map(|&[a, b, _]| [a, b]).collect::<Vec<u8>>();
    let quantised = |p: &Planes, bits: u32| -> Vec<u8> {
        // To so many bits each, the middle kept.
        let step = 1i32 << (8 - bits);
        let code = |v: u8| ((i32::from(v) - 128) as f64 / f64::from(step)).round() as i32 * step + 128;
        p.normals.iter().map(|v| code(*v).clamp(0, 255) as u8).collect()
    };
    let mut coders: Vec<(String, Coder<'static>)> = vec![
        ("PNG, 2 channels".to_owned(), lossless(|p| png(&p.normals, size(p), ExtendedColorType::La8))),
        ("WebP lossless".to_owned(), lossless(|p| webp_lossless(&padded(&p.normals), size(p)))),
        ("WebP lossless, libwebp".to_owned(), lossless(|p| libwebp_lossless(&padded(&p.normals), size(p)))),
        ("deflate 9".to_owned(), lossless(|p| deflate(&p.normals))),
        ("deflate 9 of differences".to_owned(), lossless(|p| deflate(&differences(&p.normals, 2, p.rect.width())))),
        ("zstd 19 of differences".to_owned(), lossless(|p| zstd(&differences(&p.normals, 2, p.rect.width())))),
    ];
    for bits in [6, 5] {
        let make: Coder<'static> = Box::new(move |p| {
            let data = quantised(p, bits);
            let (bytes, nanos) = timed(|| webp_lossless(&padded(&data), size(p)));
            Coded { bytes: bytes.len(), again: Some(data), nanos }
        });
        coders.push((format!("WebP lossless, {bits} bits"), make));
    }
    for quality in [50u8, 90, 95] {
        let encode = move |p: &Planes| jpeg(&padded(&p.normals), size(p), quality);
        coders.push((format!("JPEG {quality}"), lossy(encode, move |b| two(again(b, ImageFormat::Jpeg)))));
    }
    coders
}

fn depth_coders() -> Vec<(&'static str, Coder<'static>)> {
    let joined = |depths: Vec<u8>, links: &[u8]| [depths, links.to_vec()].concat();
    vec![
        ("one 16-bit PNG of 10 + 6 bits", lossless(|p| png(&native(&packed(p)), size(p), ExtendedColorType::L16))),
        (
            "16-bit PNG of depths, 8-bit PNG of links",
            lossless(|p| {
                let depths = png(&native(&p.depths), size(p), ExtendedColorType::L16);
                [depths, png(&p.links, size(p), ExtendedColorType::L8)].concat()
            }),
        ),
        (
            "WebP lossless: low byte, high bits, links",
            lossless(|p| {
                let rgb: Vec<u8> =
                    p.depths.iter().zip(&p.links).flat_map(|(d, l)| [*d as u8, (*d >> 8) as u8, *l]).collect();
                webp_lossless(&rgb, size(p))
            }),
        ),
        (
            "WebP lossless: high bits, low byte, links",
            lossless(|p| {
                let rgb: Vec<u8> =
                    p.depths.iter().zip(&p.links).flat_map(|(d, l)| [(*d >> 8) as u8, *d as u8, *l]).collect();
                webp_lossless(&rgb, size(p))
            }),
        ),
        (
            "WebP lossless, libwebp: low byte, high bits, links",
            lossless(|p| {
                let rgb: Vec<u8> =
                    p.depths.iter().zip(&p.links).flat_map(|(d, l)| [*d as u8, (*d >> 8) as u8, *l]).collect();
                libwebp_lossless(&rgb, size(p))
            }),
        ),
        (
            "WebP lossless, libwebp: predicted depths, links",
            lossless(|p| {
                let coded = codes(p);
                let (low, high) = coded.split_at(p.depths.len());
                let rgb: Vec<u8> = low.iter().zip(high).zip(&p.links).flat_map(|((l, h), k)| [*l, *h, *k]).collect();
                libwebp_lossless(&rgb, size(p))
            }),
        ),
        ("zstd 19 of 16 bits", lossless(|p| zstd(&native(&packed(p))))),
        ("zstd 19 of predicted depths, links", lossless(move |p| zstd(&joined(codes(p), &p.links)))),
        ("deflate 9 of 16 bits ([DRVW]: ZIP)", lossless(|p| deflate(&native(&packed(p))))),
        ("deflate 9 of predicted depths, links", lossless(move |p| deflate(&joined(codes(p), &p.links)))),
        (
            "WebP lossless of predicted depths, links",
            lossless(|p| {
                let coded = codes(p);
                let (low, high) = coded.split_at(p.depths.len());
                let rgb: Vec<u8> = low.iter().zip(high).zip(&p.links).flat_map(|((l, h), k)| [*l, *h, *k]).collect();
                webp_lossless(&rgb, size(p))
            }),
        ),
    ]
}

/// Sums over the samples.
#[derive(Clone, Copy, Default)]
struct Sum {
    bytes: u64,
    nanos: u64,
    /// Squares of errors.
    squares: f64,
    count: u64,
    most: f64,
}

fn sum(samples: &[Sample], coder: &Coder<'_>, error: impl Fn(&Planes, &[u8], usize) -> f64 + Sync) -> Sum {
    let each = samples.par_iter().map(|sample| {
        let planes = &sample.planes;
        let coded = coder(planes);
        let mut sum = Sum { bytes: coded.bytes as u64, nanos: coded.nanos, ..Sum::default() };
        if let Some(again) = &coded.again {
            for pixel in (0..planes.links.len()).filter(|i| planes.is_shown(*i)) {
                let off = error(planes, again, pixel);
                sum.squares += off * off;
                sum.count += 1;
                sum.most = sum.most.max(off);
            }
        }
        sum
    });
    each.collect::<Vec<_>>().into_iter().fold(Sum::default(), |a, b| Sum {
        bytes: a.bytes + b.bytes,
        nanos: a.nanos + b.nanos,
        squares: a.squares + b.squares,
        count: a.count + b.count,
        most: a.most.max(b.most),
    })
}

/// Root of the mean square over three channels, bytes.
fn colour_error(planes: &Planes, again: &[u8], pixel: usize) -> f64 {
    let off = |c: usize| {
        let at = 3 * pixel + c;
        f64::from(planes.colours[at]) - f64::from(again.get(at).copied().unwrap_or_default())
    };
    ((0..3).map(|c| off(c) * off(c)).sum::<f64>() / 3.0).sqrt()
}

/// Angle, degrees.
fn normal_error(planes: &Planes, again: &[u8], pixel: usize) -> f64 {
    let at = |data: &[u8]| match data.get(2 * pixel..2 * pixel + 2) {
        Some(&[a, b]) => foresight_index::format::orthoview::from_octahedral([a, b]),
        _ => [0.0; 3],
    };
    let (a, b) = (at(&planes.normals), at(again));
    let cosine: f32 = a.iter().zip(b).map(|(a, b)| a * b).sum();
    libm::acos(f64::from(cosine).clamp(-1.0, 1.0)).to_degrees()
}

/// The tables of a scene's samples.
///
/// # Errors
/// No sample.
pub fn findings(name: &str, samples: &[Sample]) -> Result<Findings, Fault> {
    if samples.is_empty() {
        return Err(Fault::new(name, "nothing is shown; expected images to code"));
    }
    let shown: u64 = samples.iter().map(|s| s.planes.shown() as u64).sum();
    let pixels: u64 = samples.iter().map(|s| s.planes.links.len() as u64).sum();
    let per_pixel = |bytes: u64| 8.0 * bytes as f64 / shown.max(1) as f64;
    let speed = |nanos: u64| pixels as f64 / 1e6 / (nanos.max(1) as f64 / 1e9);
    let of = format!("{name}: {} images, {:.1} M pixels shown", samples.len(), shown as f64 / 1e6);

    let mut colours = Table::new(
        format!("{of}: colours"),
        &["codec", "MB", "bits a pixel shown", "PSNR, dB", "coded, Mpixel/s and core"],
    );
    let mut curve: [Vec<(f64, f64)>; 2] = Default::default();
    for (name, coder) in colour_coders() {
        let sum = sum(samples, &coder, colour_error);
        let mean = sum.squares / sum.count.max(1) as f64;
        let psnr = (sum.count > 0).then(|| 10.0 * libm::log10(255.0 * 255.0 / mean.max(1e-9)));
        if let Some(psnr) = psnr {
            curve[usize::from(name.starts_with("WebP"))].push((per_pixel(sum.bytes), psnr));
        }
        let lossless = || json!("lossless");
        colours.row([
            json!(name),
            json!(sum.bytes as f64 / 1e6),
            json!(per_pixel(sum.bytes)),
            psnr.map_or_else(lossless, |p| json!(p)),
            json!(speed(sum.nanos)),
        ]);
    }
    let mut normals = Table::new(
        format!("{of}: normals on the octahedron, 8 bits each"),
        &["codec", "MB", "bits a pixel shown", "mean square angle, °", "largest, °", "coded, Mpixel/s and core"],
    );
    for (name, coder) in normal_coders() {
        let sum = sum(samples, &coder, normal_error);
        let root = (sum.squares / sum.count.max(1) as f64).sqrt();
        normals.row([
            json!(name),
            json!(sum.bytes as f64 / 1e6),
            json!(per_pixel(sum.bytes)),
            json!(root),
            json!(sum.most),
            json!(speed(sum.nanos)),
        ]);
    }
    let mut depths = Table::new(
        format!("{of}: 10 bits of depth, 6 of connectivity, lossless"),
        &["codec", "MB", "bits a pixel shown", "coded, Mpixel/s and core"],
    );
    for (name, coder) in depth_coders() {
        let sum = sum(samples, &coder, |_, _, _| 0.0);
        depths.row([json!(name), json!(sum.bytes as f64 / 1e6), json!(per_pixel(sum.bytes)), json!(speed(sum.nanos))]);
    }
    let curve_of = |name: &str, points: &[(f64, f64)]| super::plot::Curve {
        name: name.to_owned(),
        points: points.to_vec(),
        dotted: true,
    };
    let plot = super::plot::Plot {
        name: "codecs-colours".to_owned(),
        title: format!("Colours of {name}: size against fidelity"),
        x: ("bits a pixel shown".to_owned(), super::plot::Scale::Linear),
        y: ("PSNR, dB".to_owned(), super::plot::Scale::Linear),
        curves: vec![curve_of("JPEG", &curve[0]), curve_of("WebP, lossy", &curve[1])],
    };
    Ok(Findings { tables: vec![colours, normals, depths], plots: vec![plot], ..Findings::default() })
}
