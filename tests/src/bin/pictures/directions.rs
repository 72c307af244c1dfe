//! From how many directions a cell is drawn, of how many there are (\[HIBR\] Figure 5), everything resident, against triangles.

use crate::flights::{Run, Scene};
use foresight_tests::stored::table::Table;
use foresight_tests::stored::{Fault, Findings};
use foresight_viewer::draw::choose::ChooseSettings;
use foresight_viewer::gpu::Picture;
use foresight_viewer::headless::{Against, Row, png};
use serde_json::json;

/// Directions of a cell that are drawn.
const DRAWN: [usize; 3] = [2, 3, 5];

/// Flies each scene, whose worlds have the given numbers of directions.
pub(crate) fn findings(scenes: &[(Scene, u32)], rate: u64) -> Result<Findings, Fault> {
    let mut findings = Findings::default();
    let columns = ["flight", "drawn of", "SSIM", "least", "holes", "PSNR, dB", "points a picture"];
    let mut table = Table::new("", &columns);
    for (scene, available) in scenes {
        let mut offscreen = scene.offscreen()?;
        table.title = format!("Everything resident, against triangles, on {}", offscreen.adapter());
        let mut references = Vec::new();
        let link = scene.link(1.0)?;
        for drawn in DRAWN {
            let choose = ChooseSettings { directions: drawn, ..ChooseSettings::default() };
            let run = Run {
                policy: "foresight",
                link: &link,
                memory: 0,
                against: Against::Geometry,
                choose,
                rate,
                everything: true,
            };
            let (mut rows, mut worst) = (Vec::new(), None::<(f64, Picture, Picture)>);
            let summary = scene.fly(&run, &mut offscreen, &mut references, |shown| {
                let ssim = shown.row.ssim.unwrap_or(1.0);
                if worst.as_ref().is_none_or(|(least, ..)| ssim < *least) {
                    worst = Some((ssim, shown.picture.clone(), shown.reference.clone()));
                }
                rows.push(shown.row.clone());
            })?;
            eprintln!("{}: {drawn} of {available}", scene.name);
            let of = |figure: fn(&Row) -> Option<f64>| {
                let values: Vec<f64> = rows.iter().filter_map(figure).collect();
                (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
            };
            table.row([
                json!(scene.name),
                json!(format!("{drawn} of {available}")),
                json!(summary.mean_ssim),
                json!(summary.worst_ssim),
                json!(of(|row| row.holes)),
                json!(of(|row| row.psnr_db)),
                json!(of(|row| Some(row.points as f64))),
            ]);
            if let Some((_, picture, reference)) = worst {
                let name =
                    format!("{}-{drawn}-of-{available}", scene.name.replace(|c: char| !c.is_ascii_alphanumeric(), "-"));
                let encoded = |picture| png(picture).map_err(|error| Fault::new(&scene.name, error));
                findings.pictures.push((format!("{name}.png"), encoded(&picture)?));
                findings.pictures.push((format!("{name}-geometry.png"), encoded(&reference)?));
            }
        }
    }
    findings.tables.push(table);
    Ok(findings)
}
