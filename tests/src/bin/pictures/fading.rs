//! Popping: how much successive frames of a slow path differ, with and without the frame before fading into each
//! (\[HIBR\] §5.3).

use crate::flights::Scene;
use crate::street::{Frames, everything, walk};
use foresight_tests::stored::table::Table;
use foresight_tests::stored::{Fault, Findings};
use foresight_viewer::draw::choose::ChooseSettings;
use foresight_viewer::gpu::{FadeSettings, Picture, Reprojection};
use serde_json::json;
use std::collections::BTreeSet;

/// Frames a second.
const RATE: f64 = 30.0;

/// Root of the mean squared difference of all channels, of 255.
fn change(a: &Picture, b: &Picture) -> f64 {
    let squares: u64 = a.rgba.iter().zip(&b.rgba).map(|(a, b)| u64::from(a.abs_diff(*b)).pow(2)).sum();
    (squares as f64 / (0.75 * a.rgba.len() as f64)).sqrt()
}

/// Walks at 0.3 m/s: with everything resident; and with what is finer than a quarter of the root arriving half-way.
pub(crate) fn findings(scene: &Scene, small: bool) -> Result<Findings, Fault> {
    let (count, viewport) = if small { (4, [160, 120]) } else { (60, [320, 240]) };
    let mut frames = Frames::new(scene)?;
    let title = format!("Change from frame to frame, of 255, on {}", frames.offscreen.adapter());
    let columns = ["walk", "fade, s", "median", "largest", "largest / median", "last frame against none"];
    let mut table = Table::new(title, &columns);
    let views = walk(count, 0.3 / RATE, 0.0, viewport);
    let resident = everything(scene);
    let coarse: BTreeSet<_> = {
        let tree = &scene.world.tree;
        let own = tree.own(tree.root()).map(|rep| tree.error(rep)).fold(f64::INFINITY, f64::min);
        resident.iter().copied().filter(|&rep| tree.error(rep) >= own / 4.0).collect()
    };
    for (name, swaps_at) in [("everything resident", 0), ("finer ones arrive half-way", count / 2)] {
        let mut last: Option<Picture> = None;
        for time_s in [0.0, 0.15, 0.5] {
            frames.list.items.clear();
            let mut fade =
                Reprojection::new(frames.offscreen.renderer(), FadeSettings { time_s, ..FadeSettings::default() });
            let mut changes = Vec::new();
            let mut before: Option<Picture> = None;
            for (at, view) in views.iter().enumerate() {
                let there = if at < swaps_at { &coarse } else { &resident };
                frames.choose(view, there, &ChooseSettings::default())?;
                let drawn = fade.picture(frames.offscreen.renderer(), view, &frames.list, 1.0 / RATE);
                let (picture, _) = drawn.map_err(|e| Fault::new("GPU", e))?;
                changes.extend(before.as_ref().map(|before| change(before, &picture)));
                before = Some(picture);
            }
            changes.sort_by(f64::total_cmp);
            let median = changes.get(changes.len() / 2).copied().unwrap_or(0.0);
            let largest = changes.last().copied().unwrap_or(0.0);
            let off = last.as_ref().zip(before.as_ref()).map(|(plain, faded)| change(plain, faded));
            table.row([
                json!(name),
                json!(time_s),
                json!(median),
                json!(largest),
                json!((median > 0.0).then(|| largest / median)),
                json!(off),
            ]);
            eprintln!("{name}, {time_s} s");
            last = last.or(before);
        }
    }
    Ok(Findings { tables: vec![table], ..Findings::default() })
}
