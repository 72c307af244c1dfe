//! What only concerns frames drawn without a window.

use clap::{Args, ValueEnum};
use std::path::PathBuf;

#[derive(Debug, Args)]
#[command(next_help_heading = "With --headless")]
pub(crate) struct HeadlessArgs {
    /// Folder for the pictures, frame_00000.png and so on, and for frames.jsonl: for each its time, the scheduler's quality,
    /// SSIM and PSNR against the reference, memory, bytes received, points and triangles, environment maps
    #[arg(long, value_name = "DIR", requires = "headless")]
    pub(crate) frames: Option<PathBuf>,
    /// Everything is resident in every frame: no link, no memory budget
    #[arg(long, requires = "headless")]
    pub(crate) reference: bool,
    /// What pictures are compared with: everything (the same view with everything resident) or geometry (its finest
    /// triangles)
    #[arg(long, default_value = "everything", value_name = "WHAT", requires = "headless")]
    pub(crate) against: AgainstWord,
    /// How surfaces are lit: unlit (as the contents have it) or sun
    #[arg(long, default_value = "unlit", value_name = "LIGHT", requires = "headless")]
    pub(crate) light: LightWord,
    /// Columns and rows of the pictures, which the scheduler takes for the viewport
    #[arg(long, default_value = "640x480", value_name = "WxH", value_parser = size, requires = "headless", conflicts_with = "viewport")]
    pub(crate) size: [u32; 2],
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum AgainstWord {
    Everything,
    Geometry,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum LightWord {
    Unlit,
    Sun,
}

fn size(text: &str) -> Result<[u32; 2], String> {
    let side = |s: &str| s.parse::<u32>().ok().filter(|n| (1..=16_384).contains(n));
    match text.split_once('x').map(|(w, h)| (side(w), side(h))) {
        Some((Some(w), Some(h))) => Ok([w, h]),
        _ => Err(format!("`{text}`; expected COLUMNSxROWS, such as 640x480, each from 1 to 16384")),
    }
}
