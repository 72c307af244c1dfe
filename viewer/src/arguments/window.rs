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
