//! `accuracy`: error against run time of every estimator, method and setting.

use super::replay;
use super::suite::Line;
use anyhow::{Context, bail};
use clap::{Args, Parser};
use foresight_index::generate::city::CityParams;
use foresight_index::generate::document::Params;
use foresight_scheduler::policy::foresight::ForesightSettings;
use foresight_scheduler::policy::specification::{PolicySpec, Trust};
use foresight_scheduler::units::Time;
use foresight_sim::accuracy::Part;
use foresight_sim::accuracy::choice::Choices;
use foresight_sim::accuracy::integral::Integrals;
use foresight_sim::accuracy::outcome::{Accuracy, SCHEMA_VERSION};
use foresight_sim::accuracy::proof::Proofs;
use foresight_sim::accuracy::scene::Scene;
use foresight_sim::accuracy::situation::{self, Source};
use foresight_sim::accuracy::worst_case::WorstCases;
use foresight_sim::accuracy::{Draws, findings, grouping, hard, scale, scene, upper_bound};
use foresight_sim::report;
use foresight_sim::suite::CASES;
use foresight_traces::link::LinkTrace;
use std::io::{IsTerminal, Write};
use std::path::PathBuf;

#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  foresight-sim accuracy --report accuracy\n  foresight-sim accuracy --proof --candidates 1000000 --json\n  \
                  foresight-sim accuracy --world city:blocks=40 --path turn --only choice,scale --largest 1e7\n  \
                  foresight-sim accuracy --only scale --policy foresight:evaluations=250\n\n\
                  Without --world, --path and --link: the built-in world and generated ones, and with --data the first replay of each case of \
                  the suite that needs recorded data. Everything but nanoseconds follows from the seed."
)]
pub(crate) struct AccuracyArgs {
    /// A world as `replay` takes it; the built-in city if only a path or link is given
    #[arg(long, value_name = "WORLD")]
    world: Option<String>,
    /// A path as `replay` takes it; the built-in flight if only a world or link is given
    #[arg(long, value_name = "PATH")]
    path: Option<String>,
    /// A link as `replay` takes it
    #[arg(long, value_name = "LINK")]
    link: Option<String>,
    /// Folder of recorded worlds, paths and links: adds the suite's cases over them
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Parts to measure, separated by commas, of integral, worst-case, choice, scale and upper-bound; all if not given
    #[arg(long, value_name = "PARTS", value_delimiter = ',', value_parser = part)]
    only: Vec<Part>,
    /// Only check that the enclosures of the integral hold, at one tolerance (1e-3), against the reference; on all threads
    #[arg(long, conflicts_with = "only")]
    proof: bool,
    /// Candidates of the integral, half of them from replays; a choice in each situation for every 400; from 100000 on the
    /// offline search for the worst case is run in full. With --proof 1000000 take about half an hour on two cores
    #[arg(long, default_value_t = 4000, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=100_000_000))]
    candidates: u64,
    /// Situations kept of each replay
    #[arg(long, default_value_t = 6, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1000))]
    situations: u32,
    /// Most representations of the worlds in which decisions are timed, 1e4 to 1e7
    #[arg(long, default_value = "1e6", value_name = "N", value_parser = representations)]
    largest: u64,
    /// Decisions timed in each of these worlds and situations
    #[arg(long, default_value_t = 240, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    decisions: u64,
    /// Policy whose decisions are timed as the world grows, as `replay` takes it, such as foresight:evaluations=250
    #[arg(long, default_value = "foresight", value_name = "NAME", value_parser = policy)]
    policy: PolicySpec,
    /// Instances of each stratum on which the upper bound is set against the exact optimum
    #[arg(long, default_value_t = 40, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    instances: u32,
    /// Seed of everything random
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Write accuracy.html and accuracy.json into this directory
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
    /// Threads of what is not timed; as many as there are processors if not given
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1024))]
    threads: Option<u32>,
}

/// Cases without recorded data, as options of `replay`.
const BUILT_IN: [(&str, &str); 4] = [
    ("built-in", "--at-most 20"),
    ("city-turn", "--world city:blocks=12,seed=7 --path turn:speed=12,duration=16 --link constant:8Mbit,60ms"),
    (
        "terrain",
        "--world terrain:size=20km,resolution=20m,seed=3 --path steady:speed=80,duration=16 --place centre,height=200 --link constant:20Mbit,60ms",
    ),
    ("asteroids", "--world asteroids:count=3000,seed=5 --path turn:speed=100,duration=16 --link constant:8Mbit,60ms"),
];

/// Seconds of a recorded path that are replayed.
const RECORDED_SECONDS: &str = "20";

/// Most candidates of a situation for which grouping is set against leaf by leaf.
const GROUPED_MOST: usize = 200;

/// Situations over all cases, at least, in which the worst case is measured.
const WORST_SCENES: usize = 20;

/// For so many candidates of the integral one choice is made in each situation.
const CANDIDATES_PER_DECISION: usize = 400;

/// Memory of a replay that does not say how many bytes.
const MEMORY: u64 = 64 << 20;

/// Sizes of the worlds in which decisions are timed.
const SIZES: [u64; 4] = [10_000, 100_000, 1_000_000, 10_000_000];

fn part(text: &str) -> Result<Part, String> {
    let known = || Part::ALL.map(|(name, _)| name).join(", ");
    let found = Part::ALL.into_iter().find(|(name, _)| *name == text);
    found.map(|(_, part)| part).ok_or_else(|| format!("`{text}`; expected of {}", known()))
}

fn policy(text: &str) -> Result<PolicySpec, String> {
    let specs = PolicySpec::parse_list(text, Trust::adapted(), None).map_err(|error| error.to_string())?;
    match <[PolicySpec; 1]>::try_from(specs) {
        Ok([spec]) if !spec.knows_the_future() => Ok(spec),
        _ => Err(format!("`{text}`; expected one policy that does not know the future")),
    }
}

fn representations(text: &str) -> Result<u64, String> {
    let count = text.parse::<f64>().ok().filter(|n| (1e4..=1e7).contains(n));
    count.map(|n| n as u64).ok_or_else(|| format!("`{text}`; expected a number from 1e4 to 1e7"))
}

/// A line on a terminal's standard error that is written over.
struct Progress {
    is_terminal: bool,
}

impl AccuracyArgs {
    fn asks(&self, part: Part) -> bool {
        if self.proof { part == Part::Integral } else { self.only.is_empty() || self.only.contains(&part) }
    }
}

impl Progress {
    fn show(&self, text: &str) {
        if self.is_terminal {
            eprint!("\r\x1b[K{text}");
        }
    }
}

pub(crate) fn run(args: &AccuracyArgs) -> anyhow::Result<()> {
    if let Some(data) = args.data.as_deref().filter(|data| !data.is_dir()) {
        bail!("{}: no such folder; expected one with scenes, paths and network in it", data.display());
    }
    replay::use_threads(args.threads)?;
    let progress = Progress { is_terminal: std::io::stderr().is_terminal() };
    let is_asked = |part: Part| args.asks(part);
    let mut outcome = Accuracy {
        schema_version: SCHEMA_VERSION,
        seed: args.seed,
        candidates: args.candidates,
        ..Accuracy::default()
    };
    let needs_cases = [Part::Integral, Part::WorstCase, Part::Choice].into_iter().any(is_asked);
    if needs_cases {
        let cases = cases(args)?;
        measure_cases(args, &cases, &progress, &mut outcome)?;
    }
    if is_asked(Part::Scale) {
        measure_scale(args, &progress, &mut outcome)?;
    }
    if is_asked(Part::UpperBound) {
        progress.show("the upper bound on tiny instances");
        outcome.upper_bound = upper_bound::rows(u64::from(args.instances), args.seed)?;
    }
    progress.show("");
    outcome.findings = findings::findings(&outcome);
    let mut out = std::io::stdout().lock();
    if args.json {
        serde_json::to_writer(&mut out, &outcome)?;
        writeln!(out)?;
    } else {
        write!(out, "{}", report::accuracy_text(&outcome))?;
    }
    if let Some(dir) = &args.report {
        let words: Vec<_> = std::env::args_os().map(|word| word.to_string_lossy().into_owned()).collect();
        let page = report::write_accuracy(&outcome, dir, &words.join(" "))?;
        if !args.json {
            writeln!(out, "report: {}", page.display())?;
        }
    }
    Ok(())
}

/// A case and the options of `replay` that name it.
struct Case {
    name: String,
    line: Vec<String>,
}

/// The world, path and link that are asked for, or all.
fn cases(args: &AccuracyArgs) -> anyhow::Result<Vec<Case>> {
    let given = [("--world", &args.world), ("--path", &args.path), ("--link", &args.link)];
    if given.iter().any(|(_, value)| value.is_some()) {
        let options = given.iter().filter_map(|(option, value)| Some([(*option).to_owned(), (*value).clone()?]));
        let words = ["--at-most", RECORDED_SECONDS].map(str::to_owned);
        let line = std::iter::once("replay".to_owned()).chain(options.flatten()).chain(words).collect();
        let name = args.world.clone().unwrap_or_else(|| "built-in city".to_owned());
        return Ok(vec![Case { name, line }]);
    }
    let line = |options: &str| std::iter::once("replay").chain(options.split_whitespace()).map(str::to_owned).collect();
    let mut cases: Vec<Case> =
        BUILT_IN.iter().map(|(name, options)| Case { name: (*name).to_owned(), line: line(options) }).collect();
    if let Some(data) = &args.data {
        for case in CASES.iter().filter(|case| case.needs_data()) {
            let Some(mut line) = case.commands(data).into_iter().next() else { continue };
            line.extend(["--at-most", RECORDED_SECONDS].map(str::to_owned));
            let name = unused(&cases, case.name);
            cases.push(Case { name, line });
        }
    }
    Ok(cases)
}

/// `name`, with a number from 2 on if a case is called so already.
fn unused(cases: &[Case], name: &str) -> String {
    let is_used = |name: &str| cases.iter().any(|case| case.name == name);
    if !is_used(name) {
        return name.to_owned();
    }
    (2..).map(|number| format!("{name} {number}")).find(|name| !is_used(name)).unwrap_or_default()
}

fn measure_cases(
    args: &AccuracyArgs,
    cases: &[Case],
    progress: &Progress,
    outcome: &mut Accuracy,
) -> anyhow::Result<()> {
    let settings = ForesightSettings::default();
    let is_asked = |part: Part| args.asks(part);
    let real = (args.candidates as usize).div_ceil(2);
    let mut random = Draws::new(args.seed);
    let mut integrals = Integrals::default();
    let mut proofs = Proofs::default();
    let mut grouped = Vec::new();
    let mut worst = WorstCases::default();
    let mut choices = Choices::new(&settings);
    for case in cases {
        progress.show(&format!("{}: opening", case.name));
        let line = Line::try_parse_from(&case.line).with_context(|| format!("case {}", case.name))?;
        let opened = replay::open(&line.replay).with_context(|| format!("case {}", case.name))?;
        let source = Source {
            name: &case.name,
            tree: &opened.world.tree,
            flight: &opened.placed.flight,
            link: &opened.link,
            memory: MEMORY,
        };
        progress.show(&format!("{}: replaying", case.name));
        let situations = situation::capture(&source, &settings, args.situations as usize)
            .with_context(|| format!("case {}", case.name))?;
        progress.show(&format!("{}: measuring", case.name));
        if args.proof {
            // Shares are rounded up, so that there are no fewer than asked for.
            let each = real.div_ceil(cases.len() * situations.len().max(1));
            for (i, situation) in situations.iter().enumerate() {
                let scene = scene::real(&case.name, source.tree, situation, &settings, each, &mut random);
                let of = format!("{}, situation {} of {}", case.name, i + 1, situations.len());
                prove(&mut proofs, &scene, &of, progress)?;
            }
            continue;
        }
        let each = (real / (cases.len() * situations.len().max(1)).max(1)).max(1);
        if is_asked(Part::Integral) {
            for (i, situation) in situations.iter().enumerate() {
                progress.show(&format!("{}: integrals, situation {} of {}", case.name, i + 1, situations.len()));
                let scene = scene::real(&case.name, source.tree, situation, &settings, each, &mut random);
                integrals.measure(&scene).with_context(|| format!("case {}", case.name))?;
            }
            progress.show(&format!("{}: grouping", case.name));
            let count = each.min(GROUPED_MOST);
            let of_case = grouping::measure(source.tree, &situations, &settings, count, args.seed);
            outcome.integral.extend(of_case.iter().filter_map(|g| grouping::row(&case.name, g)));
            grouped.push(of_case);
        }
        if is_asked(Part::Choice) {
            let decisions = (args.candidates as usize / CANDIDATES_PER_DECISION).clamp(1, 1000);
            for (i, situation) in situations.iter().enumerate() {
                progress.show(&format!("{}: choices, situation {} of {}", case.name, i + 1, situations.len()));
                choices.measure(&case.name, source.tree, situation, &settings, decisions);
            }
        }
        if is_asked(Part::WorstCase) {
            let scenes = WORST_SCENES.div_ceil(cases.len()).min(situations.len());
            for (i, situation) in situations.iter().take(scenes).enumerate() {
                progress.show(&format!("{}: worst case, situation {} of {scenes}", case.name, i + 1));
                worst
                    .measure(&case.name, source.tree, situation, &settings, args.candidates, &mut random)
                    .with_context(|| format!("case {}", case.name))?;
            }
        }
    }
    if args.proof {
        for scene in hard::scenes(args.candidates.div_ceil(2) as usize, args.seed) {
            let scene = scene?;
            prove(&mut proofs, &scene, &scene.case, progress)?;
        }
        outcome.integral = proofs.rows();
        outcome.proof = Some(proofs.counts);
        return Ok(());
    }
    outcome.worst_case = worst.rows();
    outcome.choice = choices.rows();
    if is_asked(Part::Integral) {
        for scene in hard::scenes(args.candidates as usize - real, args.seed) {
            let scene = scene?;
            progress.show(&format!("{}: integrals", scene.case));
            integrals.measure(&scene).with_context(|| format!("scene {}", scene.case))?;
        }
        let over_all = grouping::over_all(&grouped);
        outcome.integral = [integrals.rows(), std::mem::take(&mut outcome.integral), over_all].concat();
        outcome.splitting = integrals.splitting();
    }
    Ok(())
}

/// Checks the enclosures of a scene. Off a terminal, a line a scene says how far it is.
fn prove(proofs: &mut Proofs, scene: &Scene, of: &str, progress: &Progress) -> anyhow::Result<()> {
    let count = scene.candidates.len();
    proofs
        .measure(scene, &|done| progress.show(&format!("{of}: {done} of {count} enclosed")))
        .with_context(|| of.to_owned())?;
    if !progress.is_terminal {
        eprintln!("{of}: {} candidates so far, {} violated", proofs.counts.candidates, proofs.counts.violated);
    }
    Ok(())
}

/// Blocks along each side of the city that has about so many representations.
fn blocks(representations: u64) -> u32 {
    // Blocks have 45 on average; districts above them add little.
    const PER_BLOCK: f64 = 44.0;
    libm::ceil((representations as f64 / PER_BLOCK).sqrt()) as u32
}

fn measure_scale(args: &AccuracyArgs, progress: &Progress, outcome: &mut Accuracy) -> anyhow::Result<()> {
    let link = LinkTrace::constant("constant", 20_000_000, Time(60_000_000))?;
    for size in SIZES.into_iter().filter(|size| *size <= args.largest) {
        progress.show(&format!("a city of about {size} representations"));
        let blocks = blocks(size);
        let params = CityParams { blocks_x: blocks, blocks_y: blocks, seed: args.seed, ..CityParams::default() };
        let world = params.build()?;
        for motion in scale::Motion::ALL {
            progress.show(&format!("{} representations, {}", world.tree.representations(), motion.name()));
            let policy = args.policy.build(&world.tree);
            outcome.scale.push(scale::decisions(&world.tree, motion, &link, args.decisions, policy)?);
        }
    }
    Ok(())
}
