//! Orthoviews on the GPU: three textures, and what is known of their tiles.

use super::device::GpuError;
use super::item::Lattice;
use super::pipelines::Layouts;
use super::texels::{check_kept, format};
use crate::scene::content::{SplatImage, Texels};
use foresight_scheduler::lod_tree::Aabb;
use std::ops::Range;
use wgpu::util::DeviceExt;

/// Pixels that the shared index buffer reaches: an image of 256 × 256 at once, larger ones in several draws.
const INDEXED_PIXELS: u32 = 1 << 16;

/// Bit of a shape that says that the pixel shows something.
const PRESENT: u16 = 0x8000;

/// Six indices a pixel, of the four corners of its quad: the same for all orthoviews.
pub(crate) fn shared_indices(device: &wgpu::Device) -> wgpu::Buffer {
    let indices: Vec<u32> = (0..INDEXED_PIXELS).flat_map(|pixel| [0, 1, 2, 2, 1, 3].map(|i| 4 * pixel + i)).collect();
    device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
        label: Some("corners of pixels"),
        contents: bytemuck::cast_slice(&indices),
        usage: wgpu::BufferUsages::INDEX,
    })
}

/// Which numbers a tile's pixels have.
#[derive(Clone, Debug)]
pub(crate) enum Tiles {
    /// All pixels of the tile: those of an orthoview, numbered tile by tile.
    Pixels,
    /// Those that show something: of a list of points.
    Ranges(Box<[Range<u32>; 16]>),
}

/// An orthoview on the GPU, or a quarter of a face of an environment map.
#[derive(Clone, Debug)]
pub(crate) struct Splats {
    pub(crate) lattice: Lattice,
    pub(crate) group: wgpu::BindGroup,
    /// Boxes around the splats of each tile, row by row upwards; empty where a tile shows nothing.
    pub(crate) tile_bounds: [Aabb; 16],
    /// Samples in each tile that show something.
    pub(crate) tile_points: [u32; 16],
    pub(crate) tiles: Tiles,
    pub(crate) bytes: u64,
}

fn check(image: &SplatImage, device: &wgpu::Device) -> Result<(), GpuError> {
    let [columns, rows] = image.size;
    let most = device.limits().max_texture_dimension_2d;
    if let Some(&side) = image.size.iter().find(|&&side| side > most) {
        return Err(GpuError::TooLarge { what: "a side of an orthoview", found: side.into(), most: most.into() });
    }
    check_kept(device, "an orthoview's colours", image.colours_kept, &[Texels::Plain, Texels::Bc1, Texels::Bc7])?;
    check_kept(device, "an orthoview's normals", image.normals_kept, &[Texels::Plain, Texels::Bc5])?;
    let colours = image.colours_kept.bytes(image.size, 4);
    let normals = if image.normals.is_empty() { 0 } else { image.normals_kept.bytes(image.size, 2) };
    let planes = [
        ("bytes of an orthoview's colours", image.colours.len(), colours),
        ("an orthoview's shapes", image.shapes.len(), u64::from(columns) * u64::from(rows)),
        ("bytes of an orthoview's normals", image.normals.len(), normals),
    ];
    match planes.into_iter().find(|&(_, found, expected)| found as u64 != expected) {
        Some((what, found, expected)) => Err(GpuError::Content { what, found: found as u64, expected }),
        None => Ok(()),
    }
}

impl Splats {
    /// `None` for an image without pixels.
    pub(crate) fn upload(
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        layouts: &Layouts,
        image: &SplatImage,
    ) -> Result<Option<Splats>, GpuError> {
        check(image, device)?;
        if image.shapes.is_empty() {
            return Ok(None);
        }
        let mut bytes = 0;
        let mut texture = |label, format, [width, height]: [u32; 2], data: &[u8]| {
            let descriptor = wgpu::TextureDescriptor {
                label: Some(label),
                size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format,
                usage: wgpu::TextureUsages::TEXTURE_BINDING,
                view_formats: &[],
            };
            bytes += data.len() as u64;
            let order = wgpu::wgt::TextureDataOrder::LayerMajor;
            let texture = device.create_texture_with_data(queue, &descriptor, order, data);
            texture.create_view(&wgpu::TextureViewDescriptor::default())
        };
        // A texture of blocks is of whole ones.
        let sized =
            |kept| if kept == Texels::Plain { image.size } else { image.size.map(|side| side.next_multiple_of(4)) };
        let colours = texture("colours", format(image.colours_kept), sized(image.colours_kept), &image.colours);
        let shapes = bytemuck::cast_slice(&image.shapes);
        let shapes = texture("shapes", wgpu::TextureFormat::R16Uint, image.size, shapes);
        let normals = match (image.normals.as_slice(), image.normals_kept) {
            // One pixel, of which nothing is read.
            ([], _) => texture("normals", wgpu::TextureFormat::Rg8Unorm, [1, 1], &[128, 128]),
            (normals, Texels::Plain) => texture("normals", wgpu::TextureFormat::Rg8Unorm, image.size, normals),
            (normals, kept) => texture("normals", format(kept), sized(kept), normals),
        };
        let entry =
            |binding, view| wgpu::BindGroupEntry { binding, resource: wgpu::BindingResource::TextureView(view) };
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("splats"),
            layout: &layouts.splats,
            entries: &[entry(0, &colours), entry(1, &shapes), entry(2, &normals)],
        });
        let lattice = Lattice::new(image);
        let (mut tile_bounds, tile_points) = tiles(image, lattice.tile());
        for bounds in tile_bounds.iter_mut().filter(|bounds| !bounds.is_empty()) {
            *bounds = Aabb { min: bounds.min - lattice.reach(), max: bounds.max + lattice.reach() };
        }
        Ok(Some(Splats { lattice, group, tile_bounds, tile_points, tiles: Tiles::Pixels, bytes }))
    }

    /// Samples in the tiles of a mask.
    pub(crate) fn points(&self, mask: u16) -> u64 {
        (0..16).filter(|tile| mask >> tile & 1 == 1).map(|tile| u64::from(self.tile_points[tile])).sum()
    }

    /// The numbers of a tile's pixels.
    fn range(&self, tile: usize) -> Range<u32> {
        match &self.tiles {
            Tiles::Pixels => {
                let [columns, rows] = self.lattice.tile();
                let area = columns * rows;
                tile as u32 * area..(tile as u32 + 1) * area
            }
            Tiles::Ranges(ranges) => ranges[tile].clone(),
        }
    }

    /// A tile's draws as an indirect draw takes them.
    pub(crate) fn arguments(&self, tile: usize) -> impl Iterator<Item = [u32; 5]> + use<> {
        let Range { start, end } = self.range(tile);
        (0..(end - start).div_ceil(INDEXED_PIXELS)).map(move |part| {
            let first = start + part * INDEXED_PIXELS;
            [6 * (end - first).min(INDEXED_PIXELS), 1, 0, 4 * first, 0]
        })
    }

    /// Draws the tiles of a mask that show something, and counts points and draws. Neighbours in the order of tiles are
    /// one range.
    pub(crate) fn draw(&self, pass: &mut wgpu::RenderPass<'_>, mask: u16) -> [u64; 2] {
        let (mut points, mut draws) = (0, 0);
        let is_drawn = |tile: usize| mask >> tile & 1 == 1 && self.tile_points[tile] > 0;
        let mut tile = 0;
        while tile < 16 {
            if !is_drawn(tile) {
                tile += 1;
                continue;
            }
            let Range { start: mut first, mut end } = self.range(tile);
            while tile < 16 && is_drawn(tile) {
                points += u64::from(self.tile_points[tile]);
                end = self.range(tile).end;
                tile += 1;
            }
            while first < end {
                let count = (end - first).min(INDEXED_PIXELS);
                pass.draw_indexed(0..6 * count, 4 * first as i32, 0..1);
                first += count;
                draws += 1;
            }
        }
        [points, draws]
    }
}

/// Box around the samples of each tile, and how many there are. A sample is half a pixel along the image's axes.
fn tiles(image: &SplatImage, tile: [u32; 2]) -> ([Aabb; 16], [u32; 16]) {
    let step = image.range / 1023.0;
    // Of each tile: least and greatest column, row and code of depth.
    let mut extents = [[[u32::MAX, 0]; 3]; 16];
    let mut points = [0u32; 16];
    let width = image.size[0].max(1) as usize;
    for (row, shapes) in image.shapes.chunks_exact(width).enumerate() {
        for (column, &shape) in shapes.iter().enumerate() {
            if shape & PRESENT == 0 {
                continue;
            }
            let (column, row) = (column as u32, row as u32);
            let at = (4 * (row / tile[1]).min(3) + (column / tile[0]).min(3)) as usize;
            points[at] += 1;
            for ([low, high], value) in extents[at].iter_mut().zip([column, row, u32::from(shape & 0x3ff)]) {
                (*low, *high) = ((*low).min(value), (*high).max(value));
            }
        }
    }
    let bounds = core::array::from_fn(|at| {
        let mut bounds = Aabb::EMPTY;
        if points[at] == 0 {
            return bounds;
        }
        for corner in 0..8 {
            let pick = |axis: usize, margin: f64| {
                let [low, high] = extents[at][axis].map(f64::from);
                if corner >> axis & 1 == 1 { high + margin } else { low - margin }
            };
            let point = image.origin + image.pixel * (pick(0, 0.5) * image.right + pick(1, 0.5) * image.up)
                - pick(2, 0.5) * step * image.towards_eye;
            bounds = bounds.union(Aabb { min: point, max: point });
        }
        bounds
    });
    (bounds, points)
}
