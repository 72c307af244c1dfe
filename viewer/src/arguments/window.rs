//! What only concerns the window.

use clap::Args;
use std::path::PathBuf;

#[derive(Debug, Args)]
#[command(next_help_heading = "In the window")]
pub(crate) struct WindowArgs {
    /// Folder in which screenshots and recorded paths are written
    #[arg(long, default_value = ".", value_name = "DIR", conflicts_with_all = ["no_draw", "headless"])]
    pub(crate) captures: PathBuf,
    /// How the camera moves in the beginning: fly, walk or orbit
    #[arg(long, default_value = "fly", value_name = "HOW", conflicts_with_all = ["no_draw", "headless"])]
    pub(crate) controls: ControlsWord,
    /// Draw less where a frame takes longer than so many milliseconds; 0 for never, which a key changes
    #[arg(long, default_value = "50", value_name = "MS", value_parser = milliseconds, conflicts_with_all = ["no_draw", "headless"])]
    pub(crate) frame_time: Option<f64>,
    /// Close the window when the path has been played to its end
    #[arg(long, requires = "path", conflicts_with_all = ["no_draw", "headless"])]
    pub(crate) close: bool,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
pub(crate) enum ControlsWord {
    Fly,
    Walk,
    Orbit,
}

fn milliseconds(text: &str) -> Result<f64, String> {
    let ms = text.parse::<f64>().ok().filter(|ms| *ms == 0.0 || (1.0..=10_000.0).contains(ms));
    ms.ok_or_else(|| format!("`{text}`; expected milliseconds from 1 to 10000, or 0"))
}
