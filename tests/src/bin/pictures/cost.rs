//! What drawing costs: time by splats, and what compressed textures save and lose.

use crate::flights::Scene;
use foresight_scheduler::lod_tree::RepId;
use foresight_sim::stopwatch::Stopwatch;
use foresight_tests::stored::table::Table;
use foresight_tests::stored::{Fault, Findings};
use foresight_viewer::draw::choose::{ChooseSettings, choose};
use foresight_viewer::draw::list::DrawList;
use foresight_viewer::gpu::{Gpu, GpuSettings, Picture, RenderSettings, Renderer};
use foresight_viewer::measure::compare;
use foresight_viewer::offscreen::FORMAT;
use foresight_viewer::scene::compress::Compression;
use foresight_viewer::scene::content::Content;
use foresight_viewer::scene::decode::decode;
use serde_json::json;
use std::collections::BTreeSet;

/// Pictures of which the median counts.
const REPEATS: usize = 5;

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or_default()
}

/// The first view of each flight from orthoviews alone.
pub(crate) fn findings(scenes: &[Scene]) -> Result<Findings, Fault> {
    let gpu = Gpu::open(&GpuSettings::default()).map_err(|error| Fault::new("GPU", error))?;
    let columns = [
        "scene",
        "textures",
        "samples",
        "splats",
        "GPU, MB",
        "compressing a content, ms",
        "uploading one, ms",
        "at most",
        "picture, ms",
        "ms per million",
        "PSNR, dB",
        "SSIM",
    ];
    let title =
        format!("Orthoviews alone, median of {REPEATS} pictures, likeness to uncompressed ones, on {}", gpu.name());
    let mut table = Table::new(title, &columns);
    for scene in scenes {
        let fault = |why: String| Fault::new(&scene.name, why);
        let all: BTreeSet<RepId> = (0..scene.world.tree.representations() as u32).map(RepId).collect();
        let Some(view) = scene.flight.views.first() else { continue };
        let settings = ChooseSettings { geometry_radius: Some(0.0), ..ChooseSettings::default() };
        let mut drawn = DrawList::default();
        choose(&scene.world, &all, view, &settings, &mut drawn);
        let mut contents = Vec::new();
        for item in &drawn.items {
            let bytes = scene.source.bytes(&scene.world, item.rep).map_err(|error| fault(error.to_string()))?;
            let decoded =
                decode(&scene.world, &scene.source, item.rep, &bytes).map_err(|error| fault(error.to_string()))?;
            if matches!(decoded.content, Content::Splats(_)) {
                contents.push((item.rep, decoded.content));
            }
        }
        // Of each number of samples, what is not compressed.
        let mut raw: [Option<Picture>; 2] = [None, None];
        for compression in Compression::ALL {
            if compression != Compression::None && !gpu.compresses() {
                continue;
            }
            let watch = Stopwatch::start();
            let kept: Vec<(RepId, Content)> =
                contents.iter().map(|(rep, content)| (*rep, content.clone().compressed(compression))).collect();
            let compressing_ms = watch.nanos() as f64 / 1e6 / contents.len().max(1) as f64;
            eprintln!("{}, {}: {compressing_ms:.2} ms to compress a content", scene.name, compression.name());
            for (samples, raw) in [1, 4].into_iter().zip(&mut raw) {
                let render = RenderSettings { samples, ..RenderSettings::default() };
                let mut renderer = Renderer::new(&gpu, render, FORMAT);
                let mut uploads_ms = Vec::new();
                for (rep, content) in &kept {
                    let watch = Stopwatch::start();
                    renderer.upload(*rep, content).map_err(|error| fault(error.to_string()))?;
                    uploads_ms.push(watch.nanos() as f64 / 1e6);
                }
                let longest_ms = uploads_ms.iter().copied().fold(0.0, f64::max);
                let upload_ms = median(uploads_ms);
                eprintln!("{upload_ms:.2} ms to upload one, {longest_ms:.2} ms at most");
                let (mut times, mut last) = (Vec::new(), None);
                // The first makes pipelines: of BC7 in software that takes minutes.
                for repeat in 0..=REPEATS {
                    let watch = Stopwatch::start();
                    let picture = renderer.picture(view, &drawn).map_err(|error| fault(error.to_string()))?;
                    let elapsed = watch.nanos() as f64 / 1e6;
                    if repeat > 0 {
                        times.push(elapsed);
                    }
                    last = Some(picture);
                }
                let Some((picture, counts)) = last else { continue };
                let reference = raw.get_or_insert_with(|| picture.clone());
                let likeness = compare(&picture, reference).map_err(|error| fault(error.to_string()))?;
                let time = median(times);
                table.row([
                    json!(scene.name),
                    json!(compression.name()),
                    json!(samples),
                    json!(counts.points),
                    json!(renderer.gpu_bytes() as f64 / 1e6),
                    json!(compressing_ms),
                    json!(upload_ms),
                    json!(longest_ms),
                    json!(time),
                    json!(time / (counts.points as f64 / 1e6)),
                    json!(likeness.map(|likeness| likeness.psnr_db).filter(|psnr| psnr.is_finite())),
                    json!(likeness.map(|likeness| likeness.ssim)),
                ]);
                eprintln!("{}, {}, {samples} samples", scene.name, compression.name());
            }
        }
    }
    Ok(Findings { tables: vec![table], ..Findings::default() })
}
