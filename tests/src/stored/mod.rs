//! What a stored world has to show: that its images are right, what they cost by codec, that building is linear, what share
//! of the geometry they take, and how many cells and how much bandwidth a moving viewer needs as the world grows.

pub mod codec;
pub mod connectivity;
pub mod correct;
pub mod headline;
pub mod levels;
pub mod linear;
pub mod picture;
pub mod plot;
pub mod ray;
pub mod scene;
pub mod sizes;
pub mod storage;
pub mod table;

use std::fmt::Display;

/// Why there is no figure.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{what}: {why}")]
pub struct Fault {
    what: String,
    why: String,
}

impl Fault {
    /// Of what, and why.
    pub fn new(what: impl Display, why: impl Display) -> Fault {
        Fault { what: what.to_string(), why: why.to_string() }
    }
}

/// A measurement as the program prints it.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct Findings {
    /// Tables, in order.
    pub tables: Vec<table::Table>,
    /// What follows from them, in words.
    pub remarks: Vec<String>,
    /// Curves.
    #[serde(skip)]
    pub plots: Vec<plot::Plot>,
    /// Images by file name, PNG.
    #[serde(skip)]
    pub pictures: Vec<(String, Vec<u8>)>,
}

impl Findings {
    /// Adds another's.
    pub fn join(&mut self, other: Findings) {
        self.tables.extend(other.tables);
        self.remarks.extend(other.remarks);
        self.plots.extend(other.plots);
        self.pictures.extend(other.pictures);
    }

    /// Writes plots and pictures into a folder, which is made.
    ///
    /// # Errors
    /// A folder or file that cannot be written.
    pub fn write(&self, folder: &std::path::Path) -> Result<(), Fault> {
        let fault = |e: std::io::Error| Fault::new(folder.display(), e);
        std::fs::create_dir_all(folder).map_err(fault)?;
        for plot in &self.plots {
            std::fs::write(folder.join(format!("{}.svg", plot.name)), plot.svg()?).map_err(fault)?;
        }
        for (name, png) in &self.pictures {
            std::fs::write(folder.join(name), png).map_err(fault)?;
        }
        Ok(())
    }
}
