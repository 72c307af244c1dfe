//! A link that is dead for a while.

use foresight_tests::input;
use foresight_tests::sidecar::case::Case;
use foresight_tests::sidecar::process::Server;

use crate::{is_sound, recovery};

/// Of the link, bytes/s: 4 Mbit/s.
const RATE: f64 = 500_000.0;

/// Flies `seconds`, undisturbed and with a link that is dead from `from_s` to `to_s`.
fn dead(from_s: u32, to_s: u32, seconds: u32, is_timed: bool) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let folder = folder.path();
    let lines = |is_dead: &dyn Fn(u32) -> bool| {
        (0..seconds + 60).map(|s| format!("{s} {}\n", if is_dead(s) { 0 } else { 4 })).collect::<String>()
    };
    input::write(folder, "sound.txt", lines(&|_| false));
    input::write(folder, "dead.txt", lines(&|s| (from_s..to_s).contains(&s)));
    let fly = |link: &str| {
        let file = folder.join(link).display().to_string();
        let case = Case::open(
            &format!(
                "--world city:blocks=20 --path steady:speed=10,duration={seconds} --link {file},rtt=40ms --memory 32MiB"
            ),
            None,
        );
        let server = Server::start(folder, &["--world", case.world(), "--link", case.link()]);
        let live = case.fly(folder, &server, &format!("{link}.jsonl"), &[]);
        is_sound(&live);
        assert_eq!(live.figure("reconnections"), 0.0, "the socket is not on the link");
        let (code, log) = server.stop();
        assert_eq!(code, Some(0), "{log}");
        (case, live)
    };
    let ((case, undisturbed), (_, disturbed)) = (fly("sound.txt"), fly("dead.txt"));
    let after = u64::from(to_s) * 1_000_000_000;
    let shown = disturbed.flown.lines.iter().filter(|line| line.event == "completed" && line.t_ns > after).count();
    assert!(shown > 0, "nothing was shown after the link had come back");
    assert_eq!(disturbed.flown.count("failed"), 0, "what only waits has not failed");
    let name = format!("link dead for {} s", to_s - from_s);
    let (allowed, returned) = recovery(&name, &case, (&undisturbed, &disturbed), f64::from(to_s), RATE);
    if is_timed {
        assert!(returned.is_some_and(|returned| returned <= allowed), "{returned:?} of {allowed} s");
    }
}

#[test]
fn the_session_outlives_a_link_that_is_dead_for_a_moment() {
    dead(3, 6, 12, false);
}

#[test]
fn the_session_outlives_a_link_that_is_dead_for_half_a_minute() {
    if let Err(skipped) = foresight_tests::full() {
        println!("{skipped}");
        return;
    }
    dead(10, 40, 80, true);
}
