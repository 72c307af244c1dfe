//! Frames in memory.

use super::device::GpuError;
use super::distance;
use super::renderer::{FrameCounts, Renderer};
use crate::draw::list::DrawList;
use foresight_scheduler::view::View;

/// A frame in memory.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Columns and rows.
    pub size: [u32; 2],
    /// sRGB and 255, four bytes a pixel, top row first.
    pub rgba: Vec<u8>,
    /// Metres along the view, top row first; infinite where nothing is.
    pub distance: Vec<f32>,
}

impl Picture {
    /// Whether nothing but the background is at a place, row by row from the top.
    pub fn is_sky(&self, index: usize) -> bool {
        self.distance.get(index).is_none_or(|distance| distance.is_infinite())
    }
}

/// A texture that is drawn into and read back, with the buffer that it is read through.
struct Readable {
    texture: wgpu::Texture,
    view: wgpu::TextureView,
    buffer: wgpu::Buffer,
    /// Bytes of a row in the buffer.
    pitch: u32,
}

impl Readable {
    /// Of a format with four bytes a pixel.
    fn new(device: &wgpu::Device, format: wgpu::TextureFormat, [width, height]: [u32; 2]) -> Readable {
        let texture = device.create_texture(&wgpu::TextureDescriptor {
            label: Some("picture"),
            size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
            view_formats: &[],
        });
        let pitch = (4 * width).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
        let buffer = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("picture"),
            size: u64::from(pitch) * u64::from(height),
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        let view = texture.create_view(&wgpu::TextureViewDescriptor::default());
        Readable { texture, view, buffer, pitch }
    }

    fn copy(&self, encoder: &mut wgpu::CommandEncoder) {
        let layout = wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(self.pitch), rows_per_image: None };
        let into = wgpu::TexelCopyBufferInfo { buffer: &self.buffer, layout };
        encoder.copy_texture_to_buffer(self.texture.as_image_copy(), into, self.texture.size());
    }

    /// The rows, without what pads them, once the work that copies them is done.
    fn read(&self, device: &wgpu::Device) -> Result<Vec<u8>, String> {
        let (sender, receiver) = std::sync::mpsc::channel();
        self.buffer.map_async(wgpu::MapMode::Read, .., move |result| drop(sender.send(result)));
        device.poll(wgpu::PollType::wait_indefinitely()).map_err(|error| error.to_string())?;
        receiver.try_recv().map_err(|error| error.to_string())?.map_err(|error| error.to_string())?;
        let mapped = self.buffer.get_mapped_range(..).map_err(|error| error.to_string())?;
        let width = 4 * self.texture.width() as usize;
        Ok(mapped.chunks_exact(self.pitch as usize).flat_map(|row| &row[..width]).copied().collect())
    }
}

impl Renderer {
    /// Draws a list off screen, `view.viewport` pixels, and reads it back. The renderer's format has to have four bytes a
    /// pixel, red first.
    ///
    /// # Errors
    /// As [`Renderer::draw`], and what cannot be read back.
    pub fn picture(&mut self, view: &View, list: &DrawList) -> Result<(Picture, FrameCounts), GpuError> {
        let size = view.viewport;
        self.read_back(size, |renderer, encoder, target| renderer.encode(encoder, view, list, target, size))
    }

    /// Encodes a frame of `size` pixels into a target of its own and reads it back.
    pub(crate) fn read_back(
        &mut self,
        size: [u32; 2],
        encode: impl FnOnce(&mut Renderer, &mut wgpu::CommandEncoder, &wgpu::TextureView) -> Result<FrameCounts, GpuError>,
    ) -> Result<(Picture, FrameCounts), GpuError> {
        super::targets::fitting(&self.device.limits(), size, 1)?;
        let memory = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let colours = Readable::new(&self.device, self.format, size);
        let distances = Readable::new(&self.device, distance::FORMAT, size);
        if let Some(error) = pollster::block_on(memory.pop()) {
            return Err(GpuError::Refused { what: "no memory for a picture", reason: error.to_string() });
        }
        let mut encoder =
            self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("picture") });
        let counts = encode(self, &mut encoder, &colours.view)?;
        self.encode_distances(&mut encoder, &distances.view);
        colours.copy(&mut encoder);
        distances.copy(&mut encoder);
        self.queue.submit([encoder.finish()]);
        let read = |from: &Readable| {
            from.read(&self.device).map_err(|reason| match self.faults.lost() {
                Some(lost) => GpuError::Lost(lost),
                None => GpuError::Refused { what: "reading a picture back", reason },
            })
        };
        let (rgba, bytes) = (read(&colours)?, read(&distances)?);
        self.faults.check("a picture")?;
        let metres = |bytes: &[u8; 4]| match f32::from_le_bytes(*bytes) {
            far if far > 3e38 => f32::INFINITY,
            metres => metres,
        };
        let distance = bytes.as_chunks::<4>().0.iter().map(metres).collect();
        Ok((Picture { size, rgba, distance }, counts))
    }
}
