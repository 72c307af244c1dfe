//! A comparison for people: a table for the terminal, a page for the browser.

mod accuracy;
mod alpha;
mod alpha_sweep;
mod downsample;
mod frame;
mod headline;
mod map;
mod metric;
mod number;
mod page;
mod plot;
mod prices;
mod scatter;
mod session;
mod suite;
mod table;

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

pub use accuracy::{accuracy_page, accuracy_text};
pub use alpha_sweep::alpha_sweep_text;
pub use session::session_text;
pub use suite::{suite_page, suite_text};
pub use table::table;

use crate::accuracy::outcome::Accuracy;
use crate::outcome::Comparison;
use crate::suite::SuiteOutcome;

/// The report as one self-contained HTML page: no script, nothing loaded from anywhere, for light and dark, from 320 px
/// of width. Equal comparisons give equal bytes.
pub fn html(comparison: &Comparison) -> String {
    page::page(comparison, None)
}

/// [`html`] with the command that repeats the comparison.
pub fn html_with_command(comparison: &Comparison, command: &str) -> String {
    page::page(comparison, Some(command))
}

/// Writes `report.html` and `comparison.json` into `dir`, which is created, and returns the path of the page. Each file
/// is written beside and then renamed, so that a reader finds the old one or the new one.
pub fn write(comparison: &Comparison, dir: &Path) -> io::Result<PathBuf> {
    write_page(comparison, dir, &html(comparison))
}

/// [`write()`] with the command that repeats the comparison.
pub fn write_with_command(comparison: &Comparison, dir: &Path, command: &str) -> io::Result<PathBuf> {
    write_page(comparison, dir, &html_with_command(comparison, command))
}

/// Writes `suite.html` and `suite.json` into `dir` as [`write()`] does, and returns the path of the page.
pub fn write_suite(outcome: &SuiteOutcome, dir: &Path) -> io::Result<PathBuf> {
    let document = serde_json::to_vec_pretty(outcome).map_err(io::Error::from)?;
    fs::create_dir_all(dir).map_err(|e| at(dir, e))?;
    replace(&dir.join("suite.json"), &document)?;
    let page = dir.join("suite.html");
    replace(&page, suite_page(outcome).as_bytes())?;
    Ok(page)
}

/// Writes `accuracy.html` and `accuracy.json` into `dir` as [`write()`] does, and returns the path of the page.
pub fn write_accuracy(outcome: &Accuracy, dir: &Path, command: &str) -> io::Result<PathBuf> {
    let document = serde_json::to_vec_pretty(outcome).map_err(io::Error::from)?;
    fs::create_dir_all(dir).map_err(|e| at(dir, e))?;
    replace(&dir.join("accuracy.json"), &document)?;
    let page = dir.join("accuracy.html");
    replace(&page, accuracy_page(outcome, command).as_bytes())?;
    Ok(page)
}

fn write_page(comparison: &Comparison, dir: &Path, page: &str) -> io::Result<PathBuf> {
    let mut document = serde_json::to_vec_pretty(comparison).map_err(io::Error::from)?;
    document.push(b'\n');
    fs::create_dir_all(dir).map_err(|e| at(dir, e))?;
    replace(&dir.join("comparison.json"), &document)?;
    let report = dir.join("report.html");
    replace(&report, page.as_bytes())?;
    Ok(report)
}

/// Writes a file beside its place and then renames it, so that a reader finds the old one or the new one.
pub fn replace(path: &Path, content: &[u8]) -> io::Result<()> {
    let beside = path.with_added_extension("partial");
    let written = fs::write(&beside, content).and_then(|()| fs::rename(&beside, path));
    if written.is_err() {
        let _ = fs::remove_file(&beside);
    }
    written.map_err(|e| at(path, e))
}

fn at(path: &Path, error: io::Error) -> io::Error {
    io::Error::new(error.kind(), format!("{}: {error}", path.display()))
}

#[cfg(test)]
mod tests;
