//! How many instructions one decision takes, counted by callgrind: a figure that repeats exactly, whatever else the
//! machine does. Each case is counted twice, in two processes, and must agree.
//!
//! Without valgrind nothing is counted: the line "skipped: …" says so, and with `CI=true` that is a failure.

mod quadtree;

use foresight_scheduler::lod_tree::{NodeId, RepId};
use foresight_scheduler::policy::foresight::{Foresight, ForesightSettings};
use foresight_scheduler::scheduler::{Action, Scheduler, SchedulerError, SchedulerSettings};
use foresight_scheduler::units::Time;
use foresight_scheduler::view::View;
use glam::{DQuat, DVec3};
use quadtree::quadtree;
use std::process::{Command, ExitCode};

/// Name, levels of the quadtree, budget beyond the coarse levels (bytes), whether the camera has turned by π since the
/// last decision.
const CASES: [(&str, u32, u64, bool); 4] = [
    ("4^5 leaves, memory free", 5, 64 << 20, false),
    ("4^7 leaves, memory free", 7, 64 << 20, false),
    ("4^7 leaves, memory full", 7, 16 << 10, false),
    ("4^7 leaves, after half a turn", 7, 64 << 20, true),
];
/// What is counted: the only function of this name in the process.
#[inline(never)]
fn one_decision(scheduler: &mut Scheduler, view: &View, now: Time) -> Result<Action, SchedulerError> {
    scheduler.observe(view, now)?;
    scheduler.next(now)
}

/// Prepares the case and decides once.
fn decide(case: usize) -> Result<(), Box<dyn std::error::Error>> {
    let (_, levels, spare, turned) = *CASES.get(case).ok_or("no such case")?;
    let tree = quadtree(levels)?;
    let fine = |node: NodeId| tree.is_leaf(node) || tree.children(node).any(|child| tree.is_leaf(child));
    let reps = (0..tree.representations() as u32).map(RepId);
    let coarse: Vec<RepId> = reps.filter(|&r| !fine(tree.node_of(r))).collect();
    let used: u64 = coarse.iter().map(|&r| tree.decoded_bytes(r)).sum();
    let policy = Foresight::checked("foresight", ForesightSettings::default())?;
    let mut scheduler = Scheduler::checked(&tree, SchedulerSettings::with_budget(used + spare), Box::new(policy))?;
    for rep in coarse {
        scheduler.preload(rep)?;
    }
    let orientation = DQuat::from_rotation_y(0.4) * DQuat::from_rotation_x(-0.2);
    let mut view = View { position: DVec3::new(3.0, 60.0, 5.0), orientation, fov_y: 1.0, viewport: [1920, 1080] };
    let mut now = Time::ZERO;
    if turned {
        scheduler.observe(&view, now)?;
        scheduler.next(now)?;
        now = Time::from_secs(0.5);
        view.orientation = DQuat::from_rotation_y(core::f64::consts::PI) * view.orientation;
    }
    one_decision(&mut scheduler, &view, now)?;
    Ok(())
}

/// Instructions of one decision, counted in a process of its own; `None` without valgrind.
fn count(case: usize) -> Result<Option<u64>, Box<dyn std::error::Error>> {
    let mut valgrind = Command::new("valgrind");
    valgrind.args(["--tool=callgrind", "--callgrind-out-file=/dev/null", "--toggle-collect=*one_decision*"]);
    valgrind.arg(std::env::current_exe()?).args(["--decide", &case.to_string()]);
    let output = match valgrind.output() {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        output => output?,
    };
    let text = String::from_utf8_lossy(&output.stderr);
    let collected = text.lines().find_map(|line| line.split_once("Collected :")?.1.split_whitespace().next());
    match collected.and_then(|figure| figure.parse().ok()) {
        Some(figure) if output.status.success() && figure > 0 => Ok(Some(figure)),
        _ => Err(format!("valgrind counted nothing: {text}").into()),
    }
}

fn run() -> Result<bool, Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    if let Some(place) = arguments.iter().position(|a| a == "--decide") {
        decide(arguments.get(place + 1).ok_or("expected a case after --decide")?.parse()?)?;
        return Ok(true);
    }
    // One small round inside the tests.
    let cases = if arguments.iter().any(|a| a == "--test") { 1 } else { CASES.len() };
    for (case, (name, ..)) in CASES.iter().enumerate().take(cases) {
        let (Some(first), Some(second)) = (count(case)?, count(case)?) else {
            println!("skipped: valgrind is not installed");
            return Ok(std::env::var("CI").as_deref() != Ok("true"));
        };
        println!("{name}: {first} instructions, {second} in a second process");
        if first != second {
            return Ok(false);
        }
    }
    Ok(true)
}

fn main() -> ExitCode {
    match run() {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}
