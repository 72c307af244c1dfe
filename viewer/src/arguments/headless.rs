//! What only concerns frames drawn without a window.

use clap::Args;
use std::path::PathBuf;

#[derive(Debug, Args)]
#[command(next_help_heading = "With --headless")]
pub(crate) struct HeadlessArgs {
    /// Folder in which the frames are written
    #[arg(long, value_name = "DIR", requires = "headless")]
    pub(crate) frames: Option<PathBuf>,
    /// Everything is resident in every frame
    #[arg(long, requires = "headless")]
    pub(crate) reference: bool,
}
