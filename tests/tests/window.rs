//! A real window: driven from the keyboard, looked at, resized, its device and its server taken away, closed.
//!
//! Pictures of the screen are kept under `FORESIGHT_PICTURES`, if that names a folder.

use std::path::{Path, PathBuf};
use std::time::Duration;

use foresight_tests::desktop::{Desktop, Screen};
use foresight_tests::program::{self, Ended};
use foresight_tests::sidecar::process::Server;
use foresight_viewer::scene::source::Source;
use glam::{DQuat, DVec3};

/// What the panels leave free of a window of 800 × 600 pixels in the screen's corner.
const MIDDLE: [u32; 4] = [360, 300, 180, 180];

/// Options of every window: no panels in the way of a whole picture are pressed away by keys.
const SIZE: [&str; 4] = ["--viewport", "800x600", "--frame-time", "0"];

fn pictures(folder: &Path) -> PathBuf {
    match std::env::var_os("FORESIGHT_PICTURES") {
        Some(kept) => PathBuf::from(kept),
        None => folder.to_owned(),
    }
}

/// A desktop, a folder to work in and the one for pictures; `None`, with a word, where there is no desktop or these tests are
/// not asked for.
fn place() -> Option<(Desktop, tempfile::TempDir, PathBuf)> {
    if let Err(reason) = foresight_tests::full() {
        println!("{reason}");
        return None;
    }
    let desktop = Desktop::start()?;
    let folder = tempfile::tempdir().expect("a temporary folder");
    let kept = pictures(folder.path());
    Some((desktop, folder, kept))
}

/// A city with its geometry and textures, in files.
fn city(folder: &Path) {
    let words = ["generate", "city", "--blocks", "2", "--out", "city"];
    let made = program::run("foresight-sim", folder, &words, &[], Duration::from_secs(300));
    assert_eq!(made.code, Some(0), "{}", made.stderr);
}

/// The same as orthoviews.
fn orthoviews(folder: &Path) {
    let words = ["build", "--input", "city:blocks=1", "--out", "built", "--leaf", "64", "--pixels", "128"];
    let made = program::run("foresight-server", folder, &words, &[], Duration::from_secs(500));
    assert_eq!(made.code, Some(0), "{}", made.stderr);
}

fn is_picture(screen: &Screen) -> bool {
    screen.colours(MIDDLE) >= 12 && screen.black(MIDDLE) < 0.5
}

fn figures(ended: &Ended) -> serde_json::Value {
    assert_eq!(ended.code, Some(0), "{}\n{}", ended.stdout, ended.stderr);
    assert!(!ended.stderr.contains("panic"), "{}", ended.stderr);
    serde_json::from_str(&ended.stdout).expect("the outcome is JSON")
}

#[test]
fn a_window_is_flown_through_resized_and_closed() {
    let Some((desktop, folder, kept)) = place() else { return };
    let folder = folder.path();
    let file = |name: &str| kept.join(name);
    orthoviews(folder);
    let mut options = vec!["--world", "built", "--memory", "512MiB", "--captures", "captures", "--json"];
    options.extend(SIZE);
    let mut window = desktop.open(folder, &options);
    let first = window.until(&file("window-overview.png"), "picture", is_picture);
    // What has come stays.
    std::thread::sleep(Duration::from_secs(10));
    window.press("r");
    window.hold("w", Duration::from_secs(3));
    let nearer = window.until(&file("window-nearer.png"), "nearer picture", |screen| {
        is_picture(screen) && screen.differs(&first, MIDDLE) > 0.3
    });
    window.drag(150, 40);
    let turned =
        window.until(&file("window-turned.png"), "turned picture", |screen| screen.differs(&nearer, MIDDLE) > 0.3);
    window.press("r");
    window.press("c");
    window.until(&file("window-levels.png"), "false colours", |screen| screen.differs(&turned, MIDDLE) > 0.3);
    window.press("c");
    window.press("c");
    window.press("c");
    window.press("h");
    window.press("F12");
    window
        .until(&file("window-keys.png"), "list of keys", |screen| screen.differs(&turned, [560, 250, 200, 200]) > 0.05);
    // Without pixels nothing is drawn, as well as with more than any texture has.
    for (width, height) in [(1, 1), (16_384, 64), (20_000, 40), (640, 480)] {
        window.resize(width, height);
        std::thread::sleep(Duration::from_secs(4));
        assert!(window.runs(), "it ended at {width} × {height}");
    }
    window.until(&file("window-smaller.png"), "smaller picture", |screen| {
        screen.colours([200, 300, 150, 150]) >= 6 && screen.black([700, 500, 300, 200]) > 0.99
    });
    // A device that is lost is made anew, and what was shown is shown again.
    window.press("F9");
    window.until(&file("window-device.png"), "picture from another device", |screen| {
        screen.colours([200, 300, 150, 150]) >= 6
    });
    window.press("Escape");
    let ended = window.finish();
    let outcome = figures(&ended);
    assert_eq!((outcome["devices_lost"].as_u64(), outcome["broken"].as_u64()), (Some(1), Some(0)), "{outcome}");
    assert!(outcome["memory_max"].as_u64() <= outcome["memory_budget"].as_u64(), "{outcome}");
    assert!(ended.stderr.contains("16384"), "{}", ended.stderr);
    let screenshot = image::open(folder.join("captures/screenshot-0001.png")).expect("a screenshot").into_rgb8();
    assert!(screenshot.pixels().any(|pixel| pixel.0.iter().any(|&c| c > 64)));
    // What was recorded is replayed, by the simulator and in a window that closes at its end.
    let path = ["--path", "captures/path-0001.jsonl", "--place", "world"];
    let mut words = vec!["replay", "--world", "built", "--json"];
    words.extend(path);
    assert_eq!(program::sim(folder, &words, Duration::from_secs(120)).code, Some(0));
    options.extend(path);
    options.push("--close");
    figures(&desktop.open(folder, &options).finish());
}

/// A pose of a recorded path: where, and along what.
struct Pose {
    position: DVec3,
    forward: DVec3,
}

/// The poses of a recording that is whole.
fn recorded(file: &Path) -> Vec<Pose> {
    for _ in 0..60 {
        if file.is_file() {
            break;
        }
        std::thread::sleep(Duration::from_millis(500));
    }
    let text = std::fs::read_to_string(file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
    let lines = text.lines().map(|line| serde_json::from_str::<serde_json::Value>(line).expect("a line is JSON"));
    let numbers = |line: &serde_json::Value, key: &str| -> Vec<f64> {
        serde_json::from_value(line[key].clone()).unwrap_or_else(|error| panic!("{key} of {line}: {error}"))
    };
    let pose = |line: serde_json::Value| {
        let orientation = DQuat::from_slice(&numbers(&line, "orientation"));
        Pose { position: DVec3::from_slice(&numbers(&line, "position")), forward: orientation * DVec3::NEG_Z }
    };
    lines.skip(1).map(pose).collect()
}

#[test]
fn who_walks_stays_on_the_ground_and_who_orbits_at_a_distance() {
    let Some((desktop, folder, kept)) = place() else { return };
    let folder = folder.path();
    let file = |name: &str| kept.join(name);
    let hills = "terrain:size=800m,resolution=10m,relief=1km";
    let (world, _) = Source::open(hills).expect("a terrain");
    let mut options = vec!["--world", hills, "--captures", "captures", "--json"];
    options.extend(SIZE);
    let mut window = desktop.open(folder, &options);
    let before = window.until(&file("walk-before.png"), "picture", |screen| screen.colours(MIDDLE) >= 2);

    // Lit, for the hills to be seen.
    window.press("l");
    window.press("2");
    window.hold("Up", Duration::from_millis(300));
    window.press("r");
    window.hold("w", Duration::from_secs(4));
    // Neither leads off the ground.
    window.hold("e", Duration::from_secs(1));
    window.hold("q", Duration::from_secs(1));
    window.hold("d", Duration::from_secs(2));
    window.press("r");
    let walked = recorded(&folder.join("captures/path-0001.jsonl"));
    let walking = window.screen(&file("walk.png"));
    assert!(walking.differs(&before, MIDDLE) > 0.3, "nothing has changed");
    let bounds = world.tree.bounds(world.tree.root());
    for Pose { position, .. } in &walked {
        let ground = world.ground_height(*position).expect("a ground");
        assert!((position.z - ground - 1.7).abs() < 1e-6, "{} m above the ground", position.z - ground);
        assert!(position.cmpge(bounds.min - 10.0).all() && position.cmple(bounds.max + 10.0).all(), "{position}");
    }
    let way = |poses: &[Pose]| poses.windows(2).map(|two| two[0].position.distance(two[1].position)).sum::<f64>();
    assert!(walked.len() > 5 && way(&walked) > 3.0, "{} poses, {} m", walked.len(), way(&walked));

    window.press("Home");
    window.press("3");
    window.press("r");
    window.hold("d", Duration::from_secs(3));
    window.hold("e", Duration::from_millis(200));
    window.drag(60, 30);
    window.press("r");
    let orbited = recorded(&folder.join("captures/path-0002.jsonl"));
    let orbiting = window.screen(&file("orbit.png"));
    // Between the panels, where the sky was.
    assert!(orbiting.differs(&walking, [368, 0, 76, 150]) > 0.5, "nothing has changed");
    let (first, last) = (&orbited[0], &orbited[orbited.len() - 1]);
    assert!(first.forward.angle_between(last.forward) > 0.3, "{} to {}", first.forward, last.forward);
    // The distance at which the first and the last look at the same place: (p₁ − p₀)·(f₀ − f₁) / |f₀ − f₁|².
    let turned = first.forward - last.forward;
    let distance = (last.position - first.position).dot(turned) / turned.length_squared();
    let pivot = first.position + distance * first.forward;
    // On the first box ahead, or in it.
    let is_inside = pivot.cmpge(bounds.min - 0.01).all() && pivot.cmple(bounds.max + 0.01).all();
    assert!(distance > 10.0 && is_inside, "{distance} m to {pivot}, in {bounds:?}");
    for Pose { position, forward } in &orbited {
        assert!((*position + distance * *forward).distance(pivot) < 1e-6 * distance, "{position} of {pivot}");
    }
    window.press("Escape");
    figures(&window.finish());
}

#[test]
fn environment_maps_are_made_anew_with_another_device() {
    let Some((desktop, folder, kept)) = place() else { return };
    let folder = folder.path();
    let file = |name: &str| kept.join(name);
    // Few pixels, so that eight maps are soon made.
    let window = ["--viewport", "200x150", "--frame-time", "0", "--environment", "4", "--json"];
    let mut window = desktop.open(folder, &[&["--world", "city:blocks=2"], &window[..]].concat());
    let whole = [0, 0, 200, 150];
    window.until(&file("maps-first.png"), "picture", |screen| screen.colours(whole) >= 12);
    window.press("F1");
    std::thread::sleep(Duration::from_secs(45));
    let before = window.screen(&file("maps-before.png"));
    window.press("F9");
    std::thread::sleep(Duration::from_secs(45));
    window.until(&file("maps-after.png"), "same picture", |screen| screen.differs(&before, whole) < 0.01);
    assert!(before.colours(whole) >= 12, "nothing was seen before");
    window.press("Escape");
    let outcome = figures(&window.finish());
    assert_eq!((outcome["devices_lost"].as_u64(), outcome["broken"].as_u64()), (Some(1), Some(0)), "{outcome}");
    assert!(outcome["maps_made"].as_u64() >= Some(16), "{outcome}");
}

#[test]
fn a_server_that_goes_and_comes_back_leaves_the_world_on_the_screen() {
    let Some((desktop, folder, kept)) = place() else { return };
    let folder = folder.path();
    let file = |name: &str| kept.join(name);
    city(folder);
    let server = Server::start(folder, &["--world", "city"]);
    let port = server.port();
    let url = server.url();
    let mut options = vec!["--server", &url, "--world", "city", "--memory", "512MiB", "--json"];
    options.extend(SIZE);
    let mut window = desktop.open(folder, &options);
    window.until(&file("server-there.png"), "picture", is_picture);
    std::thread::sleep(Duration::from_secs(5));
    let there = window.screen(&file("server-there.png"));
    server.kill();
    // The world stays, and a line in the middle below says what is the matter.
    let notice = [150, 500, 500, 60];
    let away =
        window.until(&file("server-away.png"), "word on the server", |screen| screen.differs(&there, notice) > 0.1);
    assert!(is_picture(&away) && away.differs(&there, MIDDLE) < 0.1, "{}", away.differs(&there, MIDDLE));
    let server = Server::start_on(folder, port, None, &["--world", "city"]);
    window.until(&file("server-back.png"), "session", |screen| screen.differs(&there, notice) < 0.05);
    window.press("Escape");
    let outcome = figures(&window.finish());
    assert_eq!((outcome["server_away"].as_u64(), outcome["broken"].as_u64()), (Some(1), Some(0)), "{outcome}");
    let (code, log) = server.stop();
    assert_eq!(code, Some(0), "{log}");
}

#[test]
fn little_memory_and_no_desktop_are_told() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let folder = folder.path();
    let viewer = |words: &[&str], environment: &[(&str, &Path)]| {
        program::run("foresight-viewer", folder, words, environment, Duration::from_secs(60))
    };
    let nowhere = Path::new("");
    let ended = viewer(&["--world", "city:blocks=1"], &[("DISPLAY", nowhere), ("WAYLAND_DISPLAY", nowhere)]);
    assert_eq!(ended.code, Some(2), "{ended:?}");
    assert!(ended.stderr.contains("no window can be opened") && ended.stderr.contains("--headless"), "{ended:?}");
    let ended = viewer(&["--server", "http://127.0.0.1:1"], &[]);
    assert!(ended.code == Some(2) && ended.stderr.contains("--world"), "{ended:?}");
    if let Err(reason) = foresight_tests::full() {
        println!("{reason}");
        return;
    }
    let Some(desktop) = Desktop::start() else { return };
    let kept = pictures(folder);
    let mut options = vec!["--world", "city:blocks=2", "--memory", "1MiB", "--json"];
    options.extend(SIZE);
    let mut window = desktop.open(folder, &options);
    let file = kept.join("little-memory.png");
    // What can be shown is shown, and a line says the rest.
    window.until(&file, "picture", |screen| screen.colours(MIDDLE) >= 3);
    window.press("Escape");
    let outcome = figures(&window.finish());
    assert!(outcome["memory_max"].as_u64() <= Some(1 << 20), "{outcome}");
}
