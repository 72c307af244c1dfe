//! The camera: a view at every tick, and what is announced of its path.

use crate::exchange::Exchange;
use foresight_scheduler::view::View;
use foresight_traces::flight::{TICKS_PER_SECOND, tick_time};
use foresight_wire::message::{Camera, ClientMessage, Path, Views, Waypoint};

/// A view as a message has it.
pub fn camera(view: &View) -> Camera {
    Camera {
        position: view.position.to_array(),
        orientation: view.orientation.to_array(),
        fov_y: view.fov_y,
        viewport: view.viewport,
        weight: 1.0,
    }
}

/// A camera on a path, sampled at 60 Hz.
#[derive(Clone, Debug)]
pub struct Cameraman<'a> {
    views: &'a [View],
    /// Where in the views the flight begins; beyond the last it goes on from the first.
    offset: usize,
    announce_s: f64,
    /// Up to which tick the path is announced.
    announced: usize,
}

impl<'a> Cameraman<'a> {
    /// Flies `views`, at least one, from `offset` on and announces `announce_s` seconds ahead; 0 for nothing.
    pub fn new(views: &'a [View], offset: usize, announce_s: f64) -> Cameraman<'a> {
        Cameraman { views, offset, announce_s, announced: 0 }
    }

    /// Ticks of the whole flight.
    pub fn ticks(&self) -> usize {
        self.views.len()
    }

    /// The view at a tick.
    pub fn view(&self, tick: usize) -> &'a View {
        &self.views[(self.offset + tick) % self.views.len()]
    }

    /// The message that the camera is where it is at `tick`, `t_ns` by the session's time.
    pub fn look(&self, tick: usize, t_ns: u64) -> ClientMessage {
        ClientMessage::View(Views { t_ns, cameras: vec![camera(self.view(tick))] })
    }

    /// A new session knows nothing of the path.
    pub fn forget_announced(&mut self) {
        self.announced = 0;
    }

    /// Once a second the path ahead, until its end is announced: at tick k the views of ticks k to k + ⌈60 s⌉ of
    /// `announce_s`. Times are those of the ticks less `epoch_ns`, when the session began.
    pub fn announce(&mut self, tick: usize, epoch_ns: u64) -> Option<ClientMessage> {
        let due = (tick as u64).is_multiple_of(TICKS_PER_SECOND) || self.announced == 0;
        if self.announce_s <= 0.0 || !due || self.announced == self.views.len() {
            return None;
        }
        let ahead = libm::ceil(self.announce_s * TICKS_PER_SECOND as f64) as usize;
        self.announced = tick.saturating_add(ahead).saturating_add(1).min(self.views.len());
        let views = (tick..self.announced)
            .map(|t| Waypoint { t_ns: tick_time(t as u64).0.saturating_sub(epoch_ns), camera: camera(self.view(t)) })
            .collect();
        Some(ClientMessage::Path(Path { views }))
    }
}

/// Where a session's camera is from.
#[derive(Clone, Debug)]
pub enum Eye<'a> {
    /// On a path that is known beforehand.
    Path(Cameraman<'a>),
    /// Moved by whoever draws.
    Hand(&'a Exchange),
}

impl Eye<'_> {
    /// As [`Cameraman::look`]; `None` if there is no camera yet.
    pub fn look(&self, tick: usize, t_ns: u64) -> Option<ClientMessage> {
        match self {
            Eye::Path(path) => Some(path.look(tick, t_ns)),
            Eye::Hand(exchange) => {
                let view = exchange.view()?;
                Some(ClientMessage::View(Views { t_ns, cameras: vec![camera(&view)] }))
            }
        }
    }

    /// As [`Cameraman::forget_announced`].
    pub fn forget_announced(&mut self) {
        if let Eye::Path(path) = self {
            path.forget_announced();
        }
    }

    /// As [`Cameraman::announce`].
    pub fn announce(&mut self, tick: usize, epoch_ns: u64) -> Option<ClientMessage> {
        match self {
            Eye::Path(path) => path.announce(tick, epoch_ns),
            Eye::Hand(_) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DQuat, DVec3};

    fn views(count: usize) -> Vec<View> {
        let view = |i| View {
            position: DVec3::new(i as f64, 0.0, 0.0),
            orientation: DQuat::IDENTITY,
            fov_y: 1.0,
            viewport: [640, 480],
        };
        (0..count).map(view).collect()
    }

    #[test]
    fn the_path_is_announced_once_a_second_until_its_end_is_known() {
        let views = views(200);
        let mut cameraman = Cameraman::new(&views, 0, 2.0);
        let mut announced = Vec::new();
        for tick in 0..200 {
            if let Some(ClientMessage::Path(path)) = cameraman.announce(tick, 0) {
                let last = path.views.last().expect("at least the present view");
                announced.push((tick, path.views[0].t_ns, path.views.len(), last.camera.position[0]));
            }
        }
        assert_eq!(announced, [(0, 0, 121, 120.0), (60, 1_000_000_000, 121, 180.0), (120, 2_000_000_000, 80, 199.0)]);
    }

    #[test]
    fn an_offset_turns_the_path_round() {
        let views = views(10);
        let cameraman = Cameraman::new(&views, 7, 0.0);
        assert_eq!((cameraman.view(0).position.x, cameraman.view(9).position.x), (7.0, 6.0));
    }
}
