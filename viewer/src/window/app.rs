//! The window's events, and what keys do.

use super::frame::Flyer;
use super::screen::Screen;
use super::{Outcome, WindowError, WindowSettings};
use crate::controls::bindings::{self, Action};
use crate::exchange::Exchange;
use crate::gpu::GpuError;
use std::sync::Arc;
use winit::application::ApplicationHandler;
use winit::dpi::PhysicalSize;
use winit::event::{ElementState, MouseButton, MouseScrollDelta, WindowEvent};
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop};
use winit::keyboard::PhysicalKey;
use winit::window::{Fullscreen, Window, WindowId};

/// From one frame to the next at least, and where nothing is seen.
const FRAME_NS: u64 = 1_000_000_000 / 60;
const HIDDEN_NS: u64 = 100_000_000;
/// Share of the monitor that a new window takes at most.
const MONITOR_SHARE: f64 = 0.9;
/// Pixels of a scroll that are one step of a wheel.
const WHEEL_PX: f64 = 50.0;
/// Devices that are opened in a row without a frame in between; beyond, the window is given up.
const DEVICES_MAX: u32 = 5;

/// Opens a window and runs it until it is closed.
pub(super) fn run(settings: &WindowSettings, exchange: &Exchange) -> Result<Outcome, WindowError> {
    let system = |error: winit::error::EventLoopError| WindowError::System(reason(&error));
    let event_loop = EventLoop::new().map_err(system)?;
    let mut app = App {
        settings,
        exchange,
        flyer: Flyer::new(settings)?,
        window: None,
        screen: None,
        egui: None,
        drags: false,
        pointer: None,
        next_ns: 0,
        reopened: 0,
        error: None,
    };
    event_loop.run_app(&mut app).map_err(system)?;
    match app.error {
        Some(error) => Err(error),
        None => Ok(app.flyer.finish(exchange)),
    }
}

/// What a window system says, without the place in the library's source that it begins with.
fn reason(error: &impl ToString) -> String {
    let text = error.to_string();
    let told = text.rsplit_once(".rs:").and_then(|(_, rest)| Some(rest.split_once(": ")?.1));
    told.unwrap_or(&text).trim_end_matches('.').to_owned()
}

struct App<'a> {
    settings: &'a WindowSettings,
    exchange: &'a Exchange,
    flyer: Flyer<'a>,
    window: Option<Arc<Window>>,
    screen: Option<Screen>,
    egui: Option<egui_winit::State>,
    /// Whether the pointer turns the camera.
    drags: bool,
    pointer: Option<[f64; 2]>,
    /// When the next frame is due.
    next_ns: u64,
    /// Devices opened since the last frame.
    reopened: u32,
    error: Option<WindowError>,
}

impl ApplicationHandler for App<'_> {
    fn resumed(&mut self, event_loop: &ActiveEventLoop) {
        if self.window.is_none()
            && let Err(error) = self.open(event_loop)
        {
            self.error = Some(error);
            event_loop.exit();
        }
    }

    fn window_event(&mut self, event_loop: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        let Some(window) = self.window.clone() else { return };
        let taken = self.egui.as_mut().is_some_and(|egui| egui.on_window_event(&window, &event).consumed);
        match event {
            WindowEvent::CloseRequested => event_loop.exit(),
            WindowEvent::Resized(size) => {
                if let Some(screen) = &mut self.screen {
                    screen.resize([size.width, size.height]);
                    self.flyer.limited(screen.limited());
                }
                self.next_ns = 0;
            }
            WindowEvent::RedrawRequested => self.frame(event_loop, &window),
            WindowEvent::Focused(false) => {
                self.flyer.pressed.release();
                self.drags = false;
            }
            WindowEvent::KeyboardInput { event, .. } => {
                let PhysicalKey::Code(code) = event.physical_key else { return };
                let Some(action) = bindings::action(&format!("{code:?}")) else { return };
                let is_down = event.state == ElementState::Pressed;
                // A key that is let go is never held, whoever has taken it.
                self.flyer.pressed.key(action, is_down && !taken);
                if is_down && !taken && !event.repeat {
                    self.press(event_loop, &window, action);
                }
            }
            WindowEvent::MouseInput { state, button: MouseButton::Left | MouseButton::Right, .. } => {
                self.drags = state == ElementState::Pressed && !taken;
            }
            WindowEvent::CursorLeft { .. } => self.pointer = None,
            WindowEvent::CursorMoved { position, .. } => {
                let at = [position.x, position.y];
                if let Some(before) = self.pointer.replace(at).filter(|_| self.drags) {
                    // As far as the picture's middle is wide in angle.
                    let per_pixel = self.settings.fov_y / f64::from(window.inner_size().height.max(1));
                    self.flyer.pressed.drag((at[0] - before[0]) * per_pixel, (before[1] - at[1]) * per_pixel);
                    self.flyer.player.stop();
                }
            }
            WindowEvent::MouseWheel { delta, .. } if !taken => self.flyer.pressed.wheel(match delta {
                MouseScrollDelta::LineDelta(_, lines) => f64::from(lines),
                MouseScrollDelta::PixelDelta(pixels) => pixels.y / WHEEL_PX,
            }),
            _ => {}
        }
    }

    fn about_to_wait(&mut self, event_loop: &ActiveEventLoop) {
        let now_ns = self.settings.clock.now_ns();
        if now_ns >= self.next_ns
            && let Some(window) = &self.window
        {
            self.next_ns = now_ns + FRAME_NS;
            // Some window systems ask for no picture of a window without pixels.
            if self.screen.as_ref().is_some_and(|screen| screen.size().contains(&0)) {
                let window = window.clone();
                self.frame(event_loop, &window);
            } else {
                window.request_redraw();
            }
        }
        event_loop.set_control_flow(ControlFlow::WaitUntil(self.settings.clock.instant(self.next_ns)));
    }

    fn exiting(&mut self, _: &ActiveEventLoop) {
        self.exchange.leave();
        // Before the window that its surface is of.
        self.screen = None;
        self.egui = None;
        self.window = None;
    }
}

impl App<'_> {
    fn open(&mut self, event_loop: &ActiveEventLoop) -> Result<(), WindowError> {
        let [mut width, mut height] = self.settings.size.map(f64::from);
        let monitor = event_loop.primary_monitor().or_else(|| event_loop.available_monitors().next());
        if let Some(monitor) = monitor.map(|monitor| monitor.size()).filter(|size| size.width > 0 && size.height > 0) {
            width = width.min(MONITOR_SHARE * f64::from(monitor.width));
            height = height.min(MONITOR_SHARE * f64::from(monitor.height));
        }
        let attributes = Window::default_attributes()
            .with_title(format!("foresight: {}", self.settings.world.name))
            .with_inner_size(PhysicalSize::new(width.max(1.0) as u32, height.max(1.0) as u32));
        let window = event_loop.create_window(attributes).map_err(|error| WindowError::System(reason(&error)))?;
        let window = Arc::new(window);
        self.screen(event_loop, &window)?;
        self.window = Some(window);
        Ok(())
    }

    /// A device, a surface and an overlay, made anew.
    fn screen(&mut self, event_loop: &ActiveEventLoop, window: &Arc<Window>) -> Result<(), GpuError> {
        // The old surface goes before there is a new one of the same window.
        (self.screen, self.egui) = (None, None);
        let screen = Screen::open(event_loop, window, self.flyer.render_settings())?;
        self.egui = Some(egui_winit::State::new(
            egui::Context::default(),
            egui::ViewportId::ROOT,
            window,
            Some(window.scale_factor() as f32),
            Some(winit::window::Theme::Dark),
            Some(screen.side_max() as usize),
        ));
        self.flyer.adapter(screen.adapter());
        self.flyer.limited(screen.limited());
        self.screen = Some(screen);
        Ok(())
    }

    fn frame(&mut self, event_loop: &ActiveEventLoop, window: &Arc<Window>) {
        let (Some(screen), Some(egui)) = (&mut self.screen, &mut self.egui) else { return };
        match self.flyer.frame(screen, egui, window, self.exchange) {
            Ok(true) => self.reopened = 0,
            Ok(false) => self.next_ns = self.settings.clock.now_ns() + HIDDEN_NS,
            Err(GpuError::Lost(why)) => self.reopen(event_loop, window, &why),
            Err(error) => self.flyer.notice(format!("The picture is not drawn: {error}")),
        }
        if self.flyer.is_over() {
            event_loop.exit();
        }
    }

    fn reopen(&mut self, event_loop: &ActiveEventLoop, window: &Arc<Window>, why: &str) {
        self.reopened += 1;
        self.flyer.device_lost(self.exchange, why);
        let opened = if self.reopened > DEVICES_MAX {
            Err(GpuError::Lost(format!("{why}, {DEVICES_MAX} times in a row")))
        } else {
            self.screen(event_loop, window)
        };
        if let Err(error) = opened {
            self.error = Some(error.into());
            event_loop.exit();
        }
    }

    fn press(&mut self, event_loop: &ActiveEventLoop, window: &Window, action: Action) {
        match action {
            Action::Close => event_loop.exit(),
            Action::FullScreen => {
                let full = window.fullscreen().is_none().then_some(Fullscreen::Borderless(None));
                window.set_fullscreen(full);
            }
            Action::Device => {
                if let Some(screen) = &mut self.screen {
                    screen.give_up();
                }
            }
            other => self.flyer.press(other),
        }
    }
}
