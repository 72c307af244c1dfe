//! What is seen while a world streams: similarity over time, by policy and link.

use crate::flights::{Run, Scene};
use foresight_tests::stored::plot::{Curve, Plot, Scale};
use foresight_tests::stored::table::Table;
use foresight_tests::stored::{Fault, Findings};
use foresight_viewer::draw::choose::ChooseSettings;
use foresight_viewer::headless::Against;
use serde_json::json;

/// Names of links, and by how much more is needed than they bring.
const LINKS: [(&str, f64); 2] = [("starved", 3.0), ("matched", 1.0)];

/// Policies that tell directions apart, and those for worlds without.
const DIRECTED: [&str; 3] = ["foresight", "lookahead", "added-benefit"];
const UNDIRECTED: [&str; 3] = ["foresight", "lookahead", "3d-tiles-renderer"];

/// Flies every scene with each policy on each link.
pub(crate) fn findings(scenes: &[Scene], rate: u64, memory: u64) -> Result<Findings, Fault> {
    let mut findings = Findings::default();
    for scene in scenes {
        let mut offscreen = scene.offscreen()?;
        let title = format!("{}, {} pictures a second, on {}", scene.name, rate, offscreen.adapter());
        let mut table = Table::new(
            title,
            &["policy", "link", "SSIM", "least", "0.9 after, s", "Q", "holes", "MB received", "PSNR, dB"],
        );
        let policies = if scene.world.tree.has_directions() { DIRECTED } else { UNDIRECTED };
        let mut references = Vec::new();
        for (kind, rho) in LINKS {
            let link = scene.link(rho)?;
            let mut curves = Vec::new();
            for policy in policies {
                let run = Run {
                    policy,
                    link: &link,
                    memory,
                    against: Against::Everything,
                    choose: ChooseSettings::default(),
                    rate,
                    everything: false,
                };
                let mut rows = Vec::new();
                let summary = scene.fly(&run, &mut offscreen, &mut references, |shown| rows.push(shown.row.clone()))?;
                eprintln!("{}, {kind}, {policy}", scene.name);
                let holes: Vec<f64> = rows.iter().filter_map(|row| row.holes).collect();
                let decibels: Vec<f64> = rows.iter().filter_map(|row| row.psnr_db).collect();
                let reached = rows.iter().find(|row| row.ssim.is_some_and(|ssim| ssim >= 0.9));
                table.row([
                    json!(policy),
                    json!(format!("{kind}, {}", link.name())),
                    json!(summary.mean_ssim),
                    json!(summary.worst_ssim),
                    json!(reached.map(|row| row.t_s)),
                    json!(summary.mean_quality),
                    json!(mean(&holes)),
                    json!(summary.bytes_received as f64 / 1e6),
                    json!(mean(&decibels)),
                ]);
                let points = rows.iter().filter_map(|row| Some((row.t_s, row.ssim?))).collect();
                curves.push(Curve { name: policy.to_owned(), points, dotted: true });
            }
            findings.plots.push(Plot {
                name: format!("streamed-{kind}-{}", scene.name.replace(|c: char| !c.is_ascii_alphanumeric(), "-")),
                title: format!("{}, {kind} link of {}", scene.name, link.name()),
                x: ("seconds".to_owned(), Scale::Linear),
                y: ("SSIM".to_owned(), Scale::Linear),
                curves,
            });
        }
        findings.tables.push(table);
    }
    Ok(findings)
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}
