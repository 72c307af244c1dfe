//! What should a 3D client download next, and what should it throw away?
//!
//! The crate knows no clock, no socket and no file: time, views and transfers come in as arguments. A client is driven
//! like this; here the network is a variable and everything arrives after a tenth of a second.
//!
//! ```
//! use foresight_scheduler::lod_tree::{Aabb, LodTreeBuilder, Representation};
//! use foresight_scheduler::policy::foresight::{Foresight, ForesightSettings};
//! use foresight_scheduler::scheduler::{Action, Scheduler, SchedulerSettings};
//! use foresight_scheduler::units::Time;
//! use foresight_scheduler::view::View;
//! use glam::{DQuat, DVec3};
//!
//! // A world: one object, ten metres ahead, with two levels of detail.
//! let mut builder = LodTreeBuilder::default();
//! builder.open()?;
//! for (wire_bytes, error) in [(2_000, 1.0), (50_000, 0.01)] {
//!     let decoded_bytes = 4 * wire_bytes;
//!     builder.add(Representation { wire_bytes, decoded_bytes, error, prerequisite: None, direction: None })?;
//! }
//! let content = Aabb { min: DVec3::new(-1.0, -1.0, -12.0), max: DVec3::new(1.0, 1.0, -10.0) };
//! builder.close(Some(content), 1.0)?;
//! let tree = builder.finish()?;
//!
//! let policy = Box::new(Foresight::new("foresight", ForesightSettings::default()));
//! let mut scheduler = Scheduler::new(&tree, SchedulerSettings::with_budget(1 << 20), policy);
//! let view = View { position: DVec3::ZERO, orientation: DQuat::IDENTITY, fov_y: 1.0, viewport: [1280, 720] };
//! let mut network = Vec::new();
//! let mut received = 0;
//! for tick in 0..60 {
//!     let now = Time(tick * 16_666_667);
//!     while let Some(&(rep, due)) = network.first().filter(|(_, due)| *due <= now) {
//!         network.remove(0);
//!         received += tree.wire_bytes(rep);
//!         scheduler.responded(rep, due)?;
//!         scheduler.progress(0, received, due)?;
//!         for freed in scheduler.arrived(rep, due)? {
//!             println!("free {freed:?}");
//!         }
//!         scheduler.completed(rep, due)?; // decoded at once
//!     }
//!     scheduler.observe(&view, now)?;
//!     loop {
//!         match scheduler.next(now)? {
//!             Action::Fetch { rep, .. } => network.push((rep, now + Time(100_000_000))),
//!             Action::Cancel(rep) => network.retain(|(r, _)| *r != rep),
//!             Action::Discard(rep) => println!("free {rep:?}"),
//!             Action::WaitUntil(_) => break,
//!         }
//!     }
//! }
//! assert_eq!(scheduler.state().resident().best_at(tree.root()), 0.01);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod benefit;
pub mod estimate;
mod excess;
pub mod integral;
pub mod lod_tree;
pub mod policy;
pub mod predict;
pub mod scheduler;
pub mod select;
pub mod setting;
mod sparse;
pub mod state;
pub mod transfer;
pub mod units;
pub mod view;
pub mod worst_case;
