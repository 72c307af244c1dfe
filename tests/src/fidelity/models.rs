//! Models before stock readers: three.js's GLTFLoader in a browser, and Khronos' validator.

use std::collections::BTreeMap;
use std::process::{Command, Stdio};
use std::time::Duration;

use foresight_scheduler::units::Time;
use foresight_traces::link::LinkTrace;
use serde::Deserialize;
use serde_json::Value;

use super::browser::{ARGUMENTS, Browser, BrowserError, Running, in_path};
use super::server::{Pages, Said, Server};

const PAGE: &str = include_str!("../../fidelity/gltf-loader.html");
const VALIDATE: &str = include_str!("../../fidelity/validate.cjs");
/// Time that a page may take.
const LIMIT: Duration = Duration::from_secs(120);

/// What a loader made of a model.
#[derive(Clone, Debug, Deserialize, PartialEq)]
pub struct Loaded {
    /// Vertices of all meshes.
    pub vertices: u64,
    /// Triangles of all meshes.
    pub triangles: u64,
    /// Width and height of each mesh's texture.
    pub textures: Vec<[u32; 2]>,
    /// Meshes whose material takes no light.
    pub unlit: u64,
    /// Meshes whose material does and that have normals.
    pub lit: u64,
    /// Meshes whose texture is repeated by a transform.
    pub repeated: u64,
    /// Least corner of the box around the vertices, in the scene's axes.
    pub min: [f64; 3],
    /// Largest corner.
    pub max: [f64; 3],
}

impl Browser {
    /// What three.js's GLTFLoader makes of each model.
    ///
    /// # Errors
    /// A page that fails or is silent.
    pub fn load_models(&self, models: &[Vec<u8>]) -> Result<Vec<Loaded>, BrowserError> {
        let mut files = BTreeMap::new();
        files.insert("/".to_owned(), ("text/html", PAGE.as_bytes().to_vec()));
        let names: Vec<String> = (0..models.len()).map(|i| format!("/model/{i}.glb")).collect();
        files
            .insert("/models.json".to_owned(), ("application/json", serde_json::json!(names).to_string().into_bytes()));
        for (name, model) in names.iter().zip(models) {
            files.insert(name.clone(), ("model/gltf-binary", model.clone()));
        }
        let link =
            LinkTrace::constant("unused", 1, Time::ZERO).map_err(|error| BrowserError::Page(error.to_string()))?;
        let server =
            Server::start(Pages { files, packages: self.packages.clone(), content: Box::new(|_| None) }, link)?;
        let profile = tempfile::tempdir()?;
        let mut chromium = Running(
            Command::new(&self.program)
                .args(ARGUMENTS)
                .arg(format!("--user-data-dir={}", profile.path().display()))
                .arg(format!("http://page.localhost:{}/", server.port))
                .stdin(Stdio::null())
                .stdout(Stdio::null())
                .stderr(Stdio::null())
                .spawn()?,
        );
        match chromium.hear(&server, LIMIT)? {
            Said::Failure(message) => Err(BrowserError::Page(message)),
            Said::Result(bytes) => {
                serde_json::from_slice(&bytes).map_err(|error| BrowserError::Page(error.to_string()))
            }
        }
    }

    /// What Khronos' glTF validator reports of each model.
    ///
    /// # Errors
    /// Node that is missing, or a validator that fails.
    pub fn validate_models(&self, models: &[Vec<u8>]) -> Result<Vec<Value>, BrowserError> {
        let node = in_path("node").ok_or(BrowserError::Missing("node"))?;
        let folder = tempfile::tempdir()?;
        let script = folder.path().join("validate.cjs");
        std::fs::write(&script, VALIDATE)?;
        let mut command = Command::new(node);
        command.arg(script).current_dir(&self.packages).stdin(Stdio::null());
        for (i, model) in models.iter().enumerate() {
            let file = folder.path().join(format!("{i}.glb"));
            std::fs::write(&file, model)?;
            command.arg(file);
        }
        let output = command.output()?;
        if !output.status.success() {
            return Err(BrowserError::Page(String::from_utf8_lossy(&output.stderr).into_owned()));
        }
        serde_json::from_slice(&output.stdout).map_err(|error| BrowserError::Page(error.to_string()))
    }
}
