//! Which textures take a content's planes.

use super::device::GpuError;
use crate::scene::content::Texels;

/// Of colours, and of numbers where kept as BC5.
pub(crate) fn format(kept: Texels) -> wgpu::TextureFormat {
    match kept {
        Texels::Plain => wgpu::TextureFormat::Rgba8UnormSrgb,
        Texels::Bc1 => wgpu::TextureFormat::Bc1RgbaUnormSrgb,
        Texels::Bc3 => wgpu::TextureFormat::Bc3RgbaUnormSrgb,
        Texels::Bc5 => wgpu::TextureFormat::Bc5RgUnorm,
        Texels::Bc7 => wgpu::TextureFormat::Bc7RgbaUnormSrgb,
    }
}

/// Refuses a plane that is kept as none of `allowed`, or in blocks that the device has no textures of.
pub(crate) fn check_kept(
    device: &wgpu::Device,
    what: &'static str,
    kept: Texels,
    allowed: &[Texels],
) -> Result<(), GpuError> {
    if !allowed.contains(&kept) {
        return Err(GpuError::Refused { what, reason: format!("kept as {kept:?}; expected one of {allowed:?}") });
    }
    if kept != Texels::Plain && !device.features().contains(wgpu::Features::TEXTURE_COMPRESSION_BC) {
        return Err(GpuError::Refused {
            what,
            reason: format!("kept as {kept:?}, which the adapter has no textures of"),
        });
    }
    Ok(())
}
