//! What the keys do. Keys go by their place on the keyboard, named as the W3C's `KeyboardEvent.code` and winit name them.

use super::rig::Input;
use std::collections::BTreeSet;

/// What a key does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Action {
    /// Held: to the front.
    Forward,
    /// Held: back.
    Back,
    /// Held: to the left.
    Left,
    /// Held: to the right.
    Right,
    /// Held: up.
    Up,
    /// Held: down.
    Down,
    /// Held: turn to the left.
    TurnLeft,
    /// Held: turn to the right.
    TurnRight,
    /// Held: look up.
    TiltUp,
    /// Held: look down.
    TiltDown,
    /// Held: hurry.
    Fast,
    /// Speeds, or an orbit's distance, by a step.
    Quicker,
    /// The other way.
    Slower,
    /// Fly.
    Fly,
    /// Walk.
    Walk,
    /// Orbit.
    Orbit,
    /// To where all of the world is seen.
    Overview,
    /// Plays the path given with `--path`, or stops it.
    Play,
    /// Begins or ends a recording of the path.
    Record,
    /// Writes the picture into a file.
    Screenshot,
    /// Shows or hides what is written over the picture.
    Overlay,
    /// The next false colours.
    FalseColour,
    /// The next shape of splats.
    Shape,
    /// Light from the normals, or the content's own.
    Light,
    /// The light around.
    LightAround,
    /// The light higher.
    LightHigher,
    /// Antialiasing on or off.
    Samples,
    /// Less is drawn where a frame takes too long, or not.
    HoldTime,
    /// What is far from environment maps, or not.
    Maps,
    /// Lists the keys.
    Keys,
    /// Opens the graphics device anew.
    Device,
    /// Full screen or not.
    FullScreen,
    /// Closes the window.
    Close,
}

/// A line of the help.
#[derive(Clone, Copy, Debug)]
pub struct Binding {
    /// Codes of the keys; any of them does it.
    pub codes: &'static [&'static str],
    /// What is printed on them.
    pub label: &'static str,
    /// What they do.
    pub action: Action,
    /// In words.
    pub what: &'static str,
}

const fn key(codes: &'static [&'static str], label: &'static str, action: Action, what: &'static str) -> Binding {
    Binding { codes, label, action, what }
}

/// All of them, in the order of the help.
pub const BINDINGS: &[Binding] = &[
    key(&["KeyW"], "W", Action::Forward, "forward"),
    key(&["KeyS"], "S", Action::Back, "back"),
    key(&["KeyA"], "A", Action::Left, "left"),
    key(&["KeyD"], "D", Action::Right, "right"),
    key(&["KeyE", "PageUp"], "E, PgUp", Action::Up, "up"),
    key(&["KeyQ", "PageDown"], "Q, PgDn", Action::Down, "down"),
    key(&["ArrowLeft"], "Left", Action::TurnLeft, "turn left (or drag)"),
    key(&["ArrowRight"], "Right", Action::TurnRight, "turn right (or drag)"),
    key(&["ArrowUp"], "Up", Action::TiltUp, "look up (or drag)"),
    key(&["ArrowDown"], "Down", Action::TiltDown, "look down (or drag)"),
    key(&["ShiftLeft", "ShiftRight"], "Shift", Action::Fast, "hurry"),
    key(&["Equal", "NumpadAdd"], "+", Action::Quicker, "quicker, nearer (or wheel)"),
    key(&["Minus", "NumpadSubtract"], "-", Action::Slower, "slower, farther (or wheel)"),
    key(&["Digit1"], "1", Action::Fly, "fly"),
    key(&["Digit2"], "2", Action::Walk, "walk on the ground"),
    key(&["Digit3"], "3", Action::Orbit, "orbit what is ahead"),
    key(&["Home"], "Home", Action::Overview, "see the whole world"),
    key(&["Space"], "Space", Action::Play, "play or stop the path"),
    key(&["KeyR"], "R", Action::Record, "record the path"),
    key(&["F12", "KeyP"], "F12, P", Action::Screenshot, "screenshot"),
    key(&["F1"], "F1", Action::Overlay, "panels"),
    key(&["KeyH"], "H", Action::Keys, "this list"),
    key(&["F2", "KeyC"], "F2, C", Action::FalseColour, "false colours"),
    key(&["F3", "KeyV"], "F3, V", Action::Shape, "shape of splats"),
    key(&["F4", "KeyL"], "F4, L", Action::Light, "light on or off"),
    key(&["Comma"], ",", Action::LightAround, "light around"),
    key(&["Period"], ".", Action::LightHigher, "light higher"),
    key(&["F6", "KeyM"], "F6, M", Action::Samples, "antialiasing"),
    key(&["KeyT"], "T", Action::HoldTime, "hold the frame time"),
    key(&["F7", "KeyN"], "F7, N", Action::Maps, "environment maps"),
    key(&["F9"], "F9", Action::Device, "open the graphics device anew"),
    key(&["F11", "KeyF"], "F11, F", Action::FullScreen, "full screen"),
    key(&["Escape"], "Esc", Action::Close, "close"),
];

/// What a key does, by its code.
pub fn action(code: &str) -> Option<Action> {
    BINDINGS.iter().find(|binding| binding.codes.contains(&code)).map(|binding| binding.action)
}

/// What is held and what the pointer has done, between two frames.
#[derive(Clone, Debug, Default)]
pub struct Pressed {
    held: BTreeSet<Action>,
    dragged: [f64; 2],
    wheel: f64,
}

impl Pressed {
    /// A key went down or up.
    pub fn key(&mut self, action: Action, is_down: bool) {
        if is_down {
            self.held.insert(action);
        } else {
            self.held.remove(&action);
        }
    }

    /// The pointer was dragged, radians to the right and upwards.
    pub fn drag(&mut self, right: f64, up: f64) {
        self.dragged[0] += right;
        self.dragged[1] += up;
    }

    /// The wheel was turned by so many steps.
    pub fn wheel(&mut self, steps: f64) {
        self.wheel += steps;
    }

    /// Nothing is held any more: the window has lost the keyboard.
    pub fn release(&mut self) {
        *self = Pressed::default();
    }

    /// What the camera is told, once a frame.
    pub fn take(&mut self) -> Input {
        let held = |action: Action| f64::from(u8::from(self.held.contains(&action)));
        let input = Input {
            forward: held(Action::Forward) - held(Action::Back),
            right: held(Action::Right) - held(Action::Left),
            up: held(Action::Up) - held(Action::Down),
            turn: held(Action::TurnRight) - held(Action::TurnLeft),
            tilt: held(Action::TiltUp) - held(Action::TiltDown),
            dragged: self.dragged,
            wheel: self.wheel,
            fast: self.held.contains(&Action::Fast),
        };
        (self.dragged, self.wheel) = ([0.0; 2], 0.0);
        input
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_key_does_two_things_and_none_is_without_help() {
        let codes: Vec<_> = BINDINGS.iter().flat_map(|binding| binding.codes).collect();
        assert_eq!(codes.iter().collect::<BTreeSet<_>>().len(), codes.len());
        let actions: BTreeSet<_> = BINDINGS.iter().map(|binding| binding.action).collect();
        assert_eq!(actions.len(), BINDINGS.len());
        assert!(BINDINGS.iter().all(|binding| !binding.what.is_empty() && !binding.label.is_empty()));
    }

    #[test]
    fn held_keys_stay_and_drags_do_not() {
        let mut pressed = Pressed::default();
        for code in ["KeyW", "KeyD", "ShiftLeft"] {
            pressed.key(action(code).unwrap(), true);
        }
        pressed.drag(0.1, -0.2);
        pressed.wheel(2.0);
        let wanted = Input { forward: 1.0, right: 1.0, fast: true, ..Input::default() };
        assert_eq!(pressed.take(), Input { dragged: [0.1, -0.2], wheel: 2.0, ..wanted });
        assert_eq!(pressed.take(), wanted);
        pressed.key(Action::Back, true);
        assert_eq!(pressed.take().forward, 0.0);
        pressed.release();
        assert_eq!(pressed.take(), Input::default());
    }
}
