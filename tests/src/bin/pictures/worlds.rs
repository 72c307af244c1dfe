//! The stored worlds that are looked at, built by `foresight-server` where they are not yet.

use foresight_tests::program;
use foresight_tests::stored::Fault;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// How a world is built.
#[derive(Clone, Debug)]
pub(crate) struct Recipe {
    /// Of its folder and in tables.
    pub(crate) name: &'static str,
    /// What `foresight-server build --input` takes.
    pub(crate) input: String,
    /// Side of a leaf, metres.
    pub(crate) leaf: u32,
    /// Pixels along it.
    pub(crate) pixels: u32,
    /// Directions at most; as the builder chooses if not given.
    pub(crate) directions: Option<u32>,
}

/// The generated worlds, and Mars where its data is.
pub(crate) fn recipes(small: bool) -> Vec<Recipe> {
    let recipe =
        |name, input: &str, leaf, pixels| Recipe { name, input: input.to_owned(), leaf, pixels, directions: None };
    if small {
        return vec![recipe("city-small", "city:blocks=2", 32, 64)];
    }
    let mut recipes = vec![
        recipe("city", "city:blocks=4", 32, 128),
        recipe("terrain", "terrain:size=1200m,resolution=2m,relief=300m,texels=128", 64, 128),
        recipe("asteroids", "asteroids:count=24,triangles=3000,spacing=60m,radius=14m", 32, 128),
    ];
    if let Some(data) = foresight_tests::data_folder() {
        let mars = data.join("scenes/mars_dingo_gap_3dtiles/tileset.json");
        recipes.push(recipe("mars", &mars.display().to_string(), 32, 128));
    }
    recipes
}

impl Recipe {
    /// The world in `folder`, which is made if it is not there.
    pub(crate) fn build(&self, folder: &Path) -> Result<PathBuf, Fault> {
        let out = folder.join(self.name);
        if out.join("world.toml").is_file() {
            return Ok(out);
        }
        eprintln!("building {}", self.name);
        std::fs::create_dir_all(folder).map_err(|error| Fault::new(folder.display(), error))?;
        let directions = self.directions.map(|count| ["--directions".to_owned(), count.to_string()]);
        let built = Command::new(program::built("foresight-server"))
            .args(["build", "--quiet", "--input", &self.input, "--out"])
            .arg(&out)
            .args(["--leaf", &self.leaf.to_string(), "--pixels", &self.pixels.to_string()])
            .args(directions.iter().flatten())
            .stdout(Stdio::null())
            .output()
            .map_err(|error| Fault::new("foresight-server", error))?;
        if built.status.success() {
            Ok(out)
        } else {
            Err(Fault::new(self.name, String::from_utf8_lossy(&built.stderr)))
        }
    }
}
