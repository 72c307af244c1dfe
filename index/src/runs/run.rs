//! A run as it is stored: plain data, without the document.

/// Names of a policy's figures, which are columns too, in the order of [`PolicyResult::figures`].
pub const FIGURES: [&str; 10] = [
    "mean_quality",
    "mean_deficit",
    "p05_quality",
    "seconds_below_0_9",
    "seconds_to_0_9",
    "share_within_16px",
    "bytes_fetched",
    "bytes_wasted",
    "bytes_cancelled",
    "evictions",
];

/// A run: what was replayed by what, and what came of it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Run {
    /// Milliseconds since 1970-01-01 UTC.
    pub started_at_ms: i64,
    /// Version of the program.
    pub program_version: String,
    /// Hash of the executable.
    pub build: String,
    /// Case of a benchmark suite.
    pub suite_case: Option<String>,
    /// Folder in which the program ran.
    pub folder: Option<String>,
    /// Arguments of the program that repeat the run.
    pub arguments: Vec<String>,
    /// The world.
    pub world: Input,
    /// The camera path.
    pub path: Input,
    /// The link.
    pub link: Input,
    /// What else the results depend on: a JSON object.
    pub settings: String,
    /// Seed of everything random.
    pub seed: u64,
    /// Equal for runs that replayed the same thing, whatever the program's version.
    pub inputs_hash: String,
    /// Equal for runs with the same results.
    pub result_hash: String,
    /// Seconds that the run took.
    pub wall_s: f64,
    /// Most memory that the process used.
    pub peak_memory_bytes: Option<u64>,
    /// Share of the frames that have something in view.
    pub nonempty_share: Option<f64>,
    /// Demand against supply.
    pub pressure: Pressure,
    /// Upper bound of the mean quality.
    pub bound_quality: Option<f64>,
    /// How it was proven.
    pub bound_method: String,
    /// One a policy, in the order of the document.
    pub results: Vec<PolicyResult>,
}

/// A world, path or link.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Input {
    /// As named on the command line.
    pub name: String,
    /// BLAKE3 of its content, hexadecimal.
    pub hash: String,
}

/// Demand against supply.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pressure {
    /// Bytes newly needed per byte of link.
    pub lambda: Option<f64>,
    /// Bytes ever needed ÷ bytes delivered.
    pub rho: Option<f64>,
    /// Memory budget ÷ the largest need.
    pub mu: Option<f64>,
    /// The largest need of a frame, decoded bytes.
    pub largest_need_bytes: u64,
}

/// What one policy reached.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PolicyResult {
    /// Name with its options.
    pub policy: String,
    /// In the order of [`FIGURES`].
    pub figures: [Figure; FIGURES.len()],
    /// Times the policy chose to do something.
    pub decisions: Option<f64>,
    /// Median, 99th percentile and maximum of the time a decision took, nanoseconds.
    pub decision_ns: [u64; 3],
}

impl PolicyResult {
    /// The figure of that name, which is one of [`FIGURES`].
    pub fn figure(&self, name: &str) -> Option<&Figure> {
        FIGURES.iter().position(|figure| *figure == name).map(|place| &self.figures[place])
    }
}

/// A figure with its interval; `None` where it was not reached or there is no interval.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Figure {
    /// Mean.
    pub value: Option<f64>,
    /// Lower end of the interval.
    pub lower: Option<f64>,
    /// Upper end of the interval.
    pub upper: Option<f64>,
}

/// A run with its number in the store.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredRun {
    /// From 1 on, in the order of recording.
    pub id: i64,
    /// The run.
    pub run: Run,
}
