//! The window's surface, the device that draws into it, and what is painted over the picture.

use crate::draw::environment::EnvironmentSettings;
use crate::draw::list::DrawList;
use crate::gpu::{Environment, EnvironmentCounts, Share, Surroundings};
use crate::gpu::{
    FadeSettings, FrameCounts, Gpu, GpuError, GpuSettings, Picture, RenderSettings, Renderer, Reprojection,
};
use egui_wgpu::ScreenDescriptor;
use foresight_scheduler::view::View;
use std::sync::Arc;
use winit::event_loop::ActiveEventLoop;
use winit::window::Window;

/// Most pixels of a surface: images of it, of its depths and of its distances take about 1 GiB. More is cut off.
const PIXELS_MAX: u64 = 1 << 25;

/// Frames in a row for which a surface may have nothing.
const FAILURES_MAX: u32 = 20;

/// What egui paints in a frame.
pub(super) struct Painted {
    pub(super) textures: egui::TexturesDelta,
    pub(super) shapes: Vec<egui::ClippedPrimitive>,
    pub(super) pixels_per_point: f32,
}

/// What became of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Presented {
    /// It is on the screen.
    Shown(FrameCounts),
    /// The window has no pixels, or nobody sees it.
    Hidden,
}

/// A surface with its device.
pub(super) struct Screen {
    gpu: Gpu,
    surface: wgpu::Surface<'static>,
    pub(super) renderer: Renderer,
    fade: Reprojection,
    environment: Option<Environment>,
    painter: egui_wgpu::Renderer,
    config: wgpu::SurfaceConfiguration,
    /// As the window is.
    wanted: [u32; 2],
    is_configured: bool,
    /// Frames in a row for which the surface had nothing.
    failures: u32,
    is_given_up: bool,
}

/// As large as an adapter allows: each side at most `side`, and not more than [`PIXELS_MAX`] in all, which the longer side gives
/// up first.
fn within([width, height]: [u32; 2], side: u32) -> [u32; 2] {
    let [mut width, mut height] = [width.min(side), height.min(side)];
    if u64::from(width) * u64::from(height) > PIXELS_MAX {
        if width >= height {
            width = width.min((PIXELS_MAX / u64::from(height.max(1))).max(u64::from(height)) as u32);
        } else {
            height = height.min((PIXELS_MAX / u64::from(width.max(1))).max(u64::from(width)) as u32);
        }
    }
    while u64::from(width) * u64::from(height) > PIXELS_MAX {
        [width, height] = [width / 2, height / 2];
    }
    [width, height]
}

impl Screen {
    /// Opens a device that can draw into a window.
    ///
    /// # Errors
    /// No adapter, or one that gives no device or cannot show anything in the window.
    pub(super) fn open(
        event_loop: &ActiveEventLoop,
        window: &Arc<Window>,
        settings: RenderSettings,
    ) -> Result<Screen, GpuError> {
        let gpu_settings = GpuSettings::default();
        let handle = Box::new(event_loop.owned_display_handle());
        let mut descriptor = wgpu::InstanceDescriptor::new_with_display_handle(handle);
        descriptor.backends = gpu_settings.backends;
        let instance = wgpu::Instance::new(descriptor);
        // Without a driver there is nothing to make a surface with.
        let surface = instance.create_surface(window.clone()).map_err(|error| GpuError::NoAdapter {
            sought: "vulkan, metal, dx12".to_owned(),
            reason: error.to_string().trim_end_matches([':', ' ', '{', '}']).to_owned(),
        })?;
        let gpu = Gpu::open_with(instance, Some(&surface), &gpu_settings)?;
        let size = window.inner_size();
        let unsupported = || GpuError::Refused {
            what: "a surface for the window",
            reason: format!("{} cannot show anything in it", gpu.name()),
        };
        let mut config = surface.get_default_config(&gpu.adapter, 1, 1).ok_or_else(unsupported)?;
        let formats = surface.get_capabilities(&gpu.adapter).formats;
        // What is painted over the picture is blended as it is stored, which takes a format that leaves sRGB to shaders.
        let plain = [wgpu::TextureFormat::Bgra8Unorm, wgpu::TextureFormat::Rgba8Unorm];
        if let Some(format) = plain.into_iter().find(|format| formats.contains(format)) {
            config.format = format;
        }
        config.present_mode = wgpu::PresentMode::AutoVsync;
        let renderer = Renderer::new(&gpu, settings, config.format);
        let fade = Reprojection::new(&renderer, FadeSettings::default());
        let painter = egui_wgpu::Renderer::new(&gpu.device, config.format, egui_wgpu::RendererOptions::default());
        let mut screen = Screen {
            gpu,
            surface,
            renderer,
            fade,
            environment: None,
            painter,
            config,
            wanted: [0, 0],
            is_configured: false,
            failures: 0,
            is_given_up: false,
        };
        screen.resize([size.width, size.height]);
        Ok(screen)
    }

    /// The adapter's name.
    pub(super) fn adapter(&self) -> String {
        self.gpu.name()
    }

    /// Longest side of a texture.
    pub(super) fn side_max(&self) -> u32 {
        self.gpu.device.limits().max_texture_dimension_2d
    }

    /// Why the device is lost, if it is.
    pub(super) fn lost(&self) -> Option<String> {
        if self.is_given_up {
            return Some("it was given up".to_owned());
        }
        // What has happened to the device is told when it is asked about its work.
        let asked = self.gpu.device.poll(wgpu::PollType::Poll);
        self.gpu.lost().or_else(|| asked.err().map(|error| error.to_string()))
    }

    /// Gives the device up: from then on it is lost.
    pub(super) fn give_up(&mut self) {
        self.gpu.device.destroy();
        self.is_given_up = true;
    }

    /// The window has another size. Without pixels nothing is drawn.
    pub(super) fn resize(&mut self, size: [u32; 2]) {
        self.wanted = size;
        let [width, height] = within(size, self.side_max());
        (self.config.width, self.config.height) = (width, height);
        self.is_configured = false;
    }

    /// Pixels that are drawn; none where the window has none.
    pub(super) fn size(&self) -> [u32; 2] {
        [self.config.width, self.config.height]
    }

    /// What is cut off, in words.
    pub(super) fn limited(&self) -> Option<String> {
        let [width, height] = self.size();
        let [wide, high] = self.wanted;
        (self.size() != self.wanted).then(|| {
            format!(
                "The window has {wide} × {high} pixels; {width} × {height} of them are drawn (the adapter's longest side is {})",
                self.side_max()
            )
        })
    }

    /// Makes environment maps as far as `share` goes, or lets them go where there are to be none, and gives the list that
    /// is to be drawn in place of `list`.
    ///
    /// # Errors
    /// A lost device.
    pub(super) fn far(
        &mut self,
        settings: Option<EnvironmentSettings>,
        around: Surroundings<'_>,
        view: &View,
        list: &DrawList,
        share: Share,
    ) -> Result<(DrawList, Option<EnvironmentCounts>), GpuError> {
        let Some(settings) = settings else {
            if let Some(mut environment) = self.environment.take() {
                environment.clear(&mut self.renderer);
            }
            return Ok((list.clone(), None));
        };
        let environment = self.environment.get_or_insert_with(|| Environment::new(settings));
        let drawn = environment.prepare(&mut self.renderer, around, view, list, share)?;
        Ok((drawn, Some(environment.counts().clone())))
    }

    /// Draws a frame, `elapsed_s` seconds after the one before if there was one, and what is painted over it.
    ///
    /// # Errors
    /// A lost device, and what it refuses.
    pub(super) fn draw(
        &mut self,
        view: &View,
        list: &DrawList,
        elapsed_s: Option<f64>,
        painted: Painted,
    ) -> Result<Presented, GpuError> {
        if elapsed_s.is_none() {
            self.fade.forget();
        }
        let Painted { mut textures, shapes, pixels_per_point } = painted;
        let (device, queue) = (&self.gpu.device, &self.gpu.queue);
        for (id, deltas) in textures.set.drain() {
            for delta in &deltas {
                self.painter.update_texture(device, queue, id, delta);
            }
        }
        let drawn = self.present(view, list, elapsed_s.unwrap_or(0.0), &shapes, pixels_per_point);
        for id in textures.free.drain() {
            self.painter.free_texture(&id);
        }
        drawn
    }

    fn present(
        &mut self,
        view: &View,
        list: &DrawList,
        elapsed_s: f64,
        shapes: &[egui::ClippedPrimitive],
        pixels_per_point: f32,
    ) -> Result<Presented, GpuError> {
        let size = self.size();
        if size.contains(&0) {
            return Ok(Presented::Hidden);
        }
        if let Some(why) = self.lost() {
            return Err(GpuError::Lost(why));
        }
        if !self.is_configured {
            self.surface.configure(&self.gpu.device, &self.config);
            self.is_configured = true;
        }
        use wgpu::CurrentSurfaceTexture as Current;
        let texture = match self.surface.get_current_texture() {
            Current::Success(texture) => texture,
            Current::Suboptimal(texture) => {
                // Where the whole window is not drawn it stays so.
                self.is_configured = self.limited().is_some();
                texture
            }
            Current::Outdated | Current::Lost | Current::Validation => {
                self.is_configured = false;
                self.failures += 1;
                if self.failures > FAILURES_MAX && self.limited().is_none() {
                    return Err(GpuError::Lost("its surface gives no picture".to_owned()));
                }
                return Ok(Presented::Hidden);
            }
            Current::Timeout | Current::Occluded => return Ok(Presented::Hidden),
        };
        self.failures = 0;
        let target = texture.texture.create_view(&wgpu::TextureViewDescriptor::default());
        let counts = self.fade.draw(&mut self.renderer, view, list, elapsed_s, &target, size)?;
        let mut encoder =
            self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("overlay") });
        let descriptor = ScreenDescriptor { size_in_pixels: size, pixels_per_point };
        let (device, queue) = (&self.gpu.device, &self.gpu.queue);
        let mut commands = self.painter.update_buffers(device, queue, &mut encoder, shapes, &descriptor);
        {
            let mut pass = encoder
                .begin_render_pass(&wgpu::RenderPassDescriptor {
                    label: Some("overlay"),
                    color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                        view: &target,
                        depth_slice: None,
                        resolve_target: None,
                        ops: wgpu::Operations { load: wgpu::LoadOp::Load, store: wgpu::StoreOp::Store },
                    })],
                    ..Default::default()
                })
                .forget_lifetime();
            self.painter.render(&mut pass, shapes, &descriptor);
        }
        commands.push(encoder.finish());
        queue.submit(commands);
        queue.present(texture);
        Ok(Presented::Shown(counts))
    }

    /// The picture without what is painted over it, in memory.
    ///
    /// # Errors
    /// A lost device, and what it refuses.
    pub(super) fn picture(&mut self, view: &View, list: &DrawList) -> Result<Picture, GpuError> {
        Ok(self.renderer.picture(view, list)?.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn surfaces_are_within_what_the_adapter_allows() {
        assert_eq!(within([1024, 768], 16384), [1024, 768]);
        assert_eq!(within([20_000, 600], 16384), [16384, 600]);
        assert_eq!(within([0, 600], 16384), [0, 600]);
        assert_eq!(within([u32::MAX, 0], 16384), [16384, 0]);
        for size in [[16384, 16384], [u32::MAX; 2], [16384, 9000], [9000, 16384]] {
            let [width, height] = within(size, 16384);
            assert!(width > 0 && height > 0 && u64::from(width) * u64::from(height) <= PIXELS_MAX, "{width} {height}");
        }
    }
}
