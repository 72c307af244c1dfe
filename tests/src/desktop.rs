//! A desktop without a monitor (Xvfb), with what a person does at it: keys, sizes of windows, pictures of the screen.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use crate::program::{self, Ended};

/// How long something may take to happen on the screen.
const HAPPENING: Duration = Duration::from_secs(120);
/// From one look at the screen to the next.
const LOOKING: Duration = Duration::from_millis(500);

/// Programs that it takes.
const PROGRAMS: [&str; 3] = ["Xvfb", "xdotool", "import"];

/// A screen of 1024 × 768 pixels, gone when dropped.
#[derive(Debug)]
pub struct Desktop {
    xvfb: Child,
    display: String,
}

/// A window on it, gone when dropped.
#[derive(Debug)]
pub struct Shown<'a> {
    desktop: &'a Desktop,
    child: Child,
    /// The window's number.
    window: String,
}

/// A picture of the screen.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Screen {
    image: image::RgbImage,
}

impl Desktop {
    /// Starts one; `None`, with a line that says so, where its programs are missing.
    ///
    /// # Panics
    /// If it does not start, and where it is missing with `CI=true`.
    pub fn start() -> Option<Desktop> {
        let is_there = |name: &&str| {
            let paths = std::env::var_os("PATH").unwrap_or_default();
            std::env::split_paths(&paths).any(|folder| folder.join(name).is_file())
        };
        if let Some(missing) = PROGRAMS.iter().find(|name| !is_there(name)) {
            assert!(std::env::var("CI").as_deref() != Ok("true"), "{missing} is missing");
            println!("skipped: {missing} is missing");
            return None;
        }
        // Servers that look for a free display by themselves at the same time can take one away from each other: each is given
        // one that it can lock.
        let first = 100 + std::process::id() % 10_000;
        let started = (first..).take(20).find_map(|display| {
            let mut xvfb = Command::new("Xvfb")
                .arg(format!(":{display}"))
                .args(["-displayfd", "1", "-screen", "0", "1024x768x24", "-nolisten", "tcp"])
                .stdin(Stdio::null())
                .stdout(Stdio::piped())
                .stderr(Stdio::null())
                .spawn()
                .expect("Xvfb starts");
            let mut told = String::new();
            let out = xvfb.stdout.take().expect("standard output is piped");
            BufReader::new(out).read_line(&mut told).expect("Xvfb says its display");
            if told.trim().is_empty() {
                let _ = xvfb.wait();
                return None;
            }
            Some(Desktop { xvfb, display: format!(":{}", told.trim()) })
        });
        assert!(started.is_some(), "Xvfb has no display");
        started
    }

    fn command(&self, name: impl AsRef<std::ffi::OsStr>) -> Command {
        let mut command = Command::new(name);
        command.env("DISPLAY", &self.display).env_remove("WAYLAND_DISPLAY").stdin(Stdio::null());
        if std::env::var_os("XDG_RUNTIME_DIR").is_none() {
            command.env("XDG_RUNTIME_DIR", std::env::temp_dir());
        }
        command
    }

    fn xdotool(&self, words: &[&str]) -> Option<String> {
        let output = self.command("xdotool").args(words).output().expect("xdotool runs");
        output.status.success().then(|| String::from_utf8_lossy(&output.stdout).into_owned())
    }

    /// Opens `foresight-viewer` with these options in a folder and waits for its window.
    ///
    /// # Panics
    /// If there is none in time.
    pub fn open(&self, folder: &Path, options: &[&str]) -> Shown<'_> {
        let mut child = self
            .command(program::built("foresight-viewer"))
            .args(options)
            .current_dir(folder)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the viewer starts");
        let mut window = None;
        for _ in 0..HAPPENING.as_millis() / LOOKING.as_millis() {
            window = self.xdotool(&["search", "--name", "^foresight: "]);
            if window.is_some() || child.try_wait().expect("a child can be asked for").is_some() {
                break;
            }
            std::thread::sleep(LOOKING);
        }
        let window = window.and_then(|found| found.lines().last().map(str::to_owned)).unwrap_or_default();
        let shown = Shown { desktop: self, child, window };
        if shown.window.is_empty() {
            let ended = shown.finish();
            panic!("no window: {ended:?}");
        }
        // No window manager gives it the keyboard.
        self.xdotool(&["windowfocus", "--sync", &shown.window]);
        self.xdotool(&["mousemove", "--window", &shown.window, "400", "300"]);
        shown
    }
}

impl Drop for Desktop {
    fn drop(&mut self) {
        let _ = self.xvfb.kill();
        let _ = self.xvfb.wait();
    }
}

impl Shown<'_> {
    /// Presses a key for so long.
    ///
    /// # Panics
    /// If it cannot be pressed.
    pub fn hold(&self, key: &str, time: Duration) {
        assert!(self.desktop.xdotool(&["keydown", key]).is_some(), "{key} cannot be pressed");
        std::thread::sleep(time);
        assert!(self.desktop.xdotool(&["keyup", key]).is_some(), "{key} cannot be let go");
    }

    /// Presses a key for a moment.
    ///
    /// # Panics
    /// If it cannot be pressed.
    pub fn press(&self, key: &str) {
        self.hold(key, Duration::from_millis(60));
    }

    /// Drags the pointer by so many pixels.
    ///
    /// # Panics
    /// If it cannot be dragged.
    pub fn drag(&self, right: i32, down: i32) {
        let (x, y) = (right.to_string(), down.to_string());
        let words = ["mousemove", "400", "400", "mousedown", "1", "mousemove_relative", "--", &x, &y, "mouseup", "1"];
        assert!(self.desktop.xdotool(&words).is_some(), "the pointer cannot be dragged");
    }

    /// Gives the window another size.
    ///
    /// # Panics
    /// If that is refused.
    pub fn resize(&self, width: u32, height: u32) {
        let (width, height) = (width.to_string(), height.to_string());
        let done = self.desktop.xdotool(&["windowsize", &self.window, &width, &height]);
        assert!(done.is_some(), "the window cannot be resized");
    }

    /// Whether it still runs.
    ///
    /// # Panics
    /// If that cannot be asked.
    pub fn runs(&mut self) -> bool {
        self.child.try_wait().expect("a child can be asked for").is_none()
    }

    /// The screen, also written into a file.
    ///
    /// # Panics
    /// If there is no picture of it.
    pub fn screen(&self, file: &Path) -> Screen {
        let status = self.desktop.command("import").args(["-window", "root"]).arg(file).status();
        assert!(status.is_ok_and(|status| status.success()), "no picture of the screen");
        Screen { image: image::open(file).expect("a PNG").into_rgb8() }
    }

    /// The first picture of the screen that is as wished.
    ///
    /// # Panics
    /// If there is none in time: `what` was expected.
    pub fn until(&mut self, file: &Path, what: &str, wished: impl Fn(&Screen) -> bool) -> Screen {
        for _ in 0..HAPPENING.as_millis() / LOOKING.as_millis() {
            std::thread::sleep(LOOKING);
            assert!(self.runs(), "the viewer has ended before {what}");
            let screen = self.screen(file);
            if wished(&screen) {
                return screen;
            }
        }
        panic!("no {what} on the screen, see {}", file.display());
    }

    /// Waits for its end: how it ended and what it said.
    ///
    /// # Panics
    /// If it does not end in time.
    pub fn finish(mut self) -> Ended {
        let stdout = program::drain(self.child.stdout.take().expect("standard output is piped"));
        let stderr = program::drain(self.child.stderr.take().expect("standard error is piped"));
        let code = program::wait(&mut self.child, HAPPENING);
        let (stdout, stderr) = (program::text(stdout), program::text(stderr));
        match code {
            Some(code) => Ended { code, stdout, stderr },
            None => panic!("the viewer still ran\n{stdout}\n{stderr}"),
        }
    }
}

impl Drop for Shown<'_> {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Screen {
    /// Share of the pixels in a part of the screen (left, top, width, height) that differ by more than 12 of 255 in a channel.
    pub fn differs(&self, other: &Screen, part: [u32; 4]) -> f64 {
        let pixels = self.part(part).zip(other.part(part));
        let (different, all) = pixels.fold((0u64, 0u64), |(different, all), (a, b)| {
            let far = a.0.iter().zip(b.0).any(|(&a, b)| a.abs_diff(b) > 12);
            (different + u64::from(far), all + 1)
        });
        different as f64 / all.max(1) as f64
    }

    /// Colours of a part of the screen, to steps of 16.
    pub fn colours(&self, part: [u32; 4]) -> usize {
        let colours: std::collections::BTreeSet<[u8; 3]> = self.part(part).map(|p| p.0.map(|c| c / 16)).collect();
        colours.len()
    }

    /// Share of a part of the screen that is black.
    pub fn black(&self, part: [u32; 4]) -> f64 {
        let (black, all) = self
            .part(part)
            .fold((0u64, 0u64), |(black, all), p| (black + u64::from(p.0.iter().all(|&c| c < 8)), all + 1));
        black as f64 / all.max(1) as f64
    }

    fn part(&self, [left, top, width, height]: [u32; 4]) -> impl Iterator<Item = &image::Rgb<u8>> {
        let (right, bottom) = ((left + width).min(self.image.width()), (top + height).min(self.image.height()));
        (top..bottom).flat_map(move |y| (left..right).map(move |x| self.image.get_pixel(x, y)))
    }
}
