//! An adapter and its device.

use std::sync::{Arc, Mutex, PoisonError};

/// Which adapter is opened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GpuSettings {
    /// Interfaces to look for it through.
    pub backends: wgpu::Backends,
    /// Whether only one without a GPU will do: the same pixels on every machine with the same driver.
    pub software: bool,
}

impl Default for GpuSettings {
    fn default() -> GpuSettings {
        GpuSettings { backends: wgpu::Backends::PRIMARY, software: false }
    }
}

/// Why nothing can be drawn.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum GpuError {
    /// There is none of the kind sought.
    #[error(
        "no graphics adapter through {sought}: {reason}. Install a driver; without a GPU, Mesa's software Vulkan does \
         (Debian: mesa-vulkan-drivers libvulkan1)"
    )]
    NoAdapter {
        /// Interfaces that were tried.
        sought: String,
        /// What they said.
        reason: String,
    },
    /// The adapter gives no device.
    #[error("the adapter {adapter} gives no device: {reason}")]
    NoDevice {
        /// Its name.
        adapter: String,
        /// What it said.
        reason: String,
    },
    /// The device is gone: its driver was reset or updated, or it was unplugged.
    #[error("the graphics device was lost: {0}. Open it anew and upload everything again")]
    Lost(String),
    /// The device refuses.
    #[error("{what}: {reason}")]
    Refused {
        /// What was asked for.
        what: &'static str,
        /// What it said.
        reason: String,
    },
    /// A picture without pixels, or with more than the adapter or the bound allows.
    #[error("a picture of {0} × {1} pixels; expected 1 to {2} a side and at most {3} MiB for it")]
    Size(u32, u32, u32, u64),
    /// A content larger than the adapter allows.
    #[error("{what} of {found}; the adapter takes {most} at most")]
    TooLarge {
        /// What.
        what: &'static str,
        /// How large it is.
        found: u64,
        /// How large it may be.
        most: u64,
    },
    /// A content that contradicts itself.
    #[error("{what}: {found}; expected {expected}")]
    Content {
        /// What.
        what: &'static str,
        /// What is there.
        found: u64,
        /// What ought to be.
        expected: u64,
    },
    /// What no camera can be.
    #[error(transparent)]
    View(#[from] foresight_scheduler::view::ViewError),
}

/// What went wrong with a device, as its callbacks tell it.
#[derive(Clone, Debug, Default)]
pub(crate) struct Faults {
    lost: Arc<Mutex<Option<String>>>,
    /// The first refusal that nobody has asked about yet.
    refused: Arc<Mutex<Option<String>>>,
}

impl Faults {
    pub(crate) fn lost(&self) -> Option<String> {
        self.lost.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// An error if the device is lost, or has refused something since the last call.
    pub(crate) fn check(&self, what: &'static str) -> Result<(), GpuError> {
        if let Some(reason) = self.lost() {
            return Err(GpuError::Lost(reason));
        }
        match self.refused.lock().unwrap_or_else(PoisonError::into_inner).take() {
            Some(reason) => Err(GpuError::Refused { what, reason }),
            None => Ok(()),
        }
    }
}

/// An adapter and its device. Surfaces come from its instance.
#[derive(Clone, Debug)]
pub struct Gpu {
    /// What surfaces are made with.
    pub instance: wgpu::Instance,
    /// What draws.
    pub adapter: wgpu::Adapter,
    /// What things are made with.
    pub device: wgpu::Device,
    /// What work is given to.
    pub queue: wgpu::Queue,
    pub(crate) faults: Faults,
}

impl Gpu {
    /// An adapter for pictures in memory.
    ///
    /// # Errors
    /// No adapter, or one that gives no device.
    pub fn open(settings: &GpuSettings) -> Result<Gpu, GpuError> {
        let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
        descriptor.backends = settings.backends;
        Gpu::open_with(wgpu::Instance::new(descriptor), None, settings)
    }

    /// An adapter of an instance that can present to a surface, if one is given.
    ///
    /// # Errors
    /// No adapter, or one that gives no device.
    pub fn open_with(
        instance: wgpu::Instance,
        surface: Option<&wgpu::Surface<'_>>,
        settings: &GpuSettings,
    ) -> Result<Gpu, GpuError> {
        let options = wgpu::RequestAdapterOptions {
            power_preference: wgpu::PowerPreference::HighPerformance,
            force_fallback_adapter: settings.software,
            compatible_surface: surface,
            apply_limit_buckets: false,
        };
        let adapter = pollster::block_on(instance.request_adapter(&options)).map_err(|error| {
            let names: Vec<_> = settings.backends.iter_names().map(|(name, _)| name.to_lowercase()).collect();
            let mut sought = if names.is_empty() { "no interface".to_owned() } else { names.join(", ") };
            if settings.software {
                sought.push_str(", in software");
            }
            GpuError::NoAdapter { sought, reason: error.to_string() }
        })?;
        let name = adapter.get_info().name;
        let wanted = wgpu::Features::TEXTURE_COMPRESSION_BC;
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("foresight"),
            required_features: adapter.features() & wanted,
            required_limits: adapter.limits(),
            ..Default::default()
        };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))
            .map_err(|error| GpuError::NoDevice { adapter: name, reason: error.to_string() })?;
        let faults = Faults::default();
        let lost = Arc::clone(&faults.lost);
        device.set_device_lost_callback(move |reason, message| {
            let text = if message.is_empty() { format!("{reason:?}") } else { message };
            lost.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(text);
        });
        let refused = Arc::clone(&faults.refused);
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            refused.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error.to_string());
        }));
        Ok(Gpu { instance, adapter, device, queue, faults })
    }

    /// Why the device is lost, if it is. Nothing is drawn from then on: a new [`Gpu`] and a new
    /// [`Renderer`](super::Renderer) are needed, and everything is to be uploaded again.
    pub fn lost(&self) -> Option<String> {
        self.faults.lost()
    }

    /// The adapter's name and the interface to it.
    pub fn name(&self) -> String {
        let info = self.adapter.get_info();
        format!("{} ({})", info.name, info.backend)
    }

    /// Whether block-compressed textures can be drawn.
    pub fn compresses(&self) -> bool {
        self.device.features().contains(wgpu::Features::TEXTURE_COMPRESSION_BC)
    }
}
