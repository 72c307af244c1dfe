//! Environment maps show what is far as its contents would, and only what they may.

use crate::scene::{Plate, gpu, looking, orthoview, renderer};
use foresight_index::orthoview::Direction;
use foresight_scheduler::lod_tree::{Aabb, LodTree, LodTreeBuilder, RepId, Representation};
use foresight_scheduler::view::View;
use foresight_viewer::draw::choose::{ChooseSettings, choose_in};
use foresight_viewer::draw::environment::EnvironmentSettings;
use foresight_viewer::draw::list::DrawList;
use foresight_viewer::gpu::{Environment, EnvironmentCounts, Gpu, GpuError, Light, Renderer, Share};
use foresight_viewer::gpu::{Picture, Surroundings};
use foresight_viewer::measure::{Likeness, compare};
use foresight_viewer::scene::content::Content;
use glam::DVec3;
use std::collections::BTreeSet;

const SIZE: [u32; 2] = [160, 120];

/// Time and memory for anything.
const AMPLE: Share = Share { bytes: 1 << 30, frames: 1 << 20, waits: true };

/// A world of one representation a node, on a renderer.
struct Place {
    renderer: Renderer,
    tree: LodTree,
    resident: BTreeSet<RepId>,
}

/// Boards of 12 m stand in three rows from 60 to 140 m all around the middle, which is at `offset`, on a floor of 400 m, and
/// two of 2 m stand near it.
fn boards(gpu: &Gpu, offset: DVec3) -> Place {
    let mut renderer = renderer(gpu);
    let mut builder = LodTreeBuilder::default();
    builder.open().expect("a root");
    let mut resident = BTreeSet::new();
    let mut add = |plate: Plate, cell: f64, signs: [i32; 3], side: u32| {
        let middle = plate.centre;
        let mut image = orthoview(&plate, Direction::from_signs(signs).expect("canonical"), middle, cell, side);
        let number = resident.len();
        for (at, colour) in image.colours.chunks_exact_mut(4).enumerate() {
            let shade = if (at / 8 + at / (8 * side as usize)).is_multiple_of(2) { 0 } else { 50 };
            colour[..3].copy_from_slice(&[
                (60 + 37 * number % 140) as u8 + shade,
                (40 + 71 * number % 160) as u8,
                90 - shade,
            ]);
        }
        builder.open().expect("a node");
        let representation =
            Representation { wire_bytes: 1, decoded_bytes: 1, error: 0.1, prerequisite: None, direction: None };
        let rep = builder.add(representation).expect("a representation");
        let reach = plate.half * (plate.axes[0].abs() + plate.axes[1].abs()) + 0.01;
        builder.close(Some(Aabb { min: middle - reach, max: middle + reach }), 1.0).expect("a box");
        renderer.upload(rep, &Content::Splats(image)).expect("an orthoview");
        resident.insert(rep);
    };
    add(Plate { centre: offset - 6.0 * DVec3::Z, axes: [DVec3::X, DVec3::Y], half: 200.0 }, 400.0, [0, 0, 1], 256);
    for (row, distance) in [60.0, 95.0, 140.0].into_iter().enumerate() {
        for column in -2..=2 {
            let aside = f64::from(column) * (15.0 + 6.0 * row as f64);
            for (away, along) in
                [(DVec3::X, DVec3::Y), (DVec3::NEG_X, DVec3::Y), (DVec3::Y, DVec3::X), (DVec3::NEG_Y, DVec3::X)]
            {
                let centre = offset + away * distance + along * aside + 2.0 * row as f64 * DVec3::Z;
                let signs = (-away).to_array().map(|sign| sign as i32);
                add(Plate { centre, axes: [along, DVec3::Z], half: 6.0 }, 12.0, signs, 64);
            }
        }
    }
    for aside in [-3.0, 3.0] {
        let centre = offset + DVec3::new(9.0, aside, -2.0);
        add(Plate { centre, axes: [DVec3::Y, DVec3::Z], half: 1.0 }, 2.0, [-1, 0, 0], 64);
    }
    let all = Aabb { min: offset - 210.0, max: offset + 210.0 };
    builder.close(Some(all), 1.0).expect("a box");
    Place { renderer, tree: builder.finish().expect("a tree"), resident }
}

impl Place {
    fn list(&self, view: &View) -> DrawList {
        let mut list = DrawList::default();
        choose_in(&self.tree, None, &self.resident, view, &ChooseSettings::default(), &mut list);
        list
    }

    fn prepare(&mut self, maps: &mut Environment, view: &View, share: Share) -> (DrawList, EnvironmentCounts) {
        let drawn = self.try_prepare(maps, view, share).expect("a list");
        (drawn, maps.counts().clone())
    }

    fn try_prepare(&mut self, maps: &mut Environment, view: &View, share: Share) -> Result<DrawList, GpuError> {
        let list = self.list(view);
        let choose = ChooseSettings::default();
        let around = Surroundings { tree: &self.tree, root_sample: None, resident: &self.resident, choose: &choose };
        maps.prepare(&mut self.renderer, around, view, &list, share)
    }

    fn picture(&mut self, view: &View, list: &DrawList) -> (Picture, u64) {
        let (picture, counts) = self.renderer.picture(view, list).expect("a picture");
        (picture, counts.map_points)
    }

    /// With maps against without.
    fn likeness(&mut self, maps: &mut Environment, view: &View) -> (Likeness, EnvironmentCounts) {
        let (drawn, counts) = self.prepare(maps, view, AMPLE);
        let (picture, points) = self.picture(view, &drawn);
        assert_eq!(points > 0, !drawn.faces.is_empty());
        let list = self.list(view);
        let (whole, _) = self.picture(view, &list);
        (compare(&picture, &whole).expect("of a size").expect("something to see"), counts)
    }
}

fn maps(side: f64) -> Environment {
    Environment::new(EnvironmentSettings::with_side(side))
}

/// Along x through two cells of 4 m, looking to and fro.
fn walk(offset: DVec3) -> impl Iterator<Item = View> {
    (0..9).map(move |step| {
        let from = offset + DVec3::new(0.3 + f64::from(step) * 0.9, 1.7, 0.4);
        looking(from, from + DVec3::new(1.0, 0.4 * f64::from(step % 3) - 0.4, -0.05), SIZE)
    })
}

#[test]
fn pictures_with_maps_are_those_without() {
    let Some(gpu) = gpu() else { return };
    // On a planet the crossing alone.
    for (offset, steps) in [(DVec3::ZERO, 0..9), (DVec3::new(6.4e6, -6.4e6, 12_345.0), 4..6)] {
        let mut place = boards(&gpu, offset);
        place.renderer.settings().samples = 4;
        let mut maps = maps(4.0);
        let mut made = Vec::new();
        for (step, view) in walk(offset).enumerate().filter(|(step, _)| steps.contains(step)) {
            let (likeness, counts) = place.likeness(&mut maps, &view);
            assert_eq!((counts.refused, counts.faces >= 48), (None, true), "{step}");
            // The four, and a base of the cell before.
            assert!((4..=5).contains(&counts.maps_drawn), "{step}: {}", counts.maps_drawn);
            // All boards of the view but the near ones; the floor reaches under the viewpoint.
            assert!(counts.left_out >= 8, "{step}: {}", counts.left_out);
            assert!(likeness.ssim > 0.92 && likeness.psnr_db > 22.0 && likeness.holes < 1e-3, "{step}: {likeness:?}");
            made.push(counts.faces_made);
        }
        // One crossing of a face, and four maps made there.
        assert_eq!(made.iter().filter(|&&faces| faces > 0).copied().collect::<Vec<_>>(), [48, 24], "{made:?}");
    }
}

#[test]
fn maps_are_made_within_the_budget_and_everything_is_drawn_by_itself_until_then() {
    let Some(gpu) = gpu() else { return };
    let mut place = boards(&gpu, DVec3::ZERO);
    let budget = 10_000;
    let mut maps =
        Environment::new(EnvironmentSettings { points_per_frame: budget, ..EnvironmentSettings::with_side(4.0) });
    let view = walk(DVec3::ZERO).next().expect("a view");
    let list = place.list(&view);
    let share = Share { frames: 1, ..AMPLE };
    let mut frames = 0;
    loop {
        let (drawn, counts) = place.prepare(&mut maps, &view, share);
        // The floor is one content of 2¹⁶ points, and of these only tiles in view.
        assert!(counts.points_in < budget + (1 << 16), "{counts:?}");
        frames += 1;
        if counts.maps_drawn == 4 {
            assert!(drawn.items.len() < list.items.len() && !drawn.faces.is_empty());
            break;
        }
        assert_eq!(drawn, list, "{frames}");
        assert!(frames < 500, "{counts:?}");
    }
    assert!(frames > 20, "{frames}");
    // Nothing more to do.
    assert_eq!(place.prepare(&mut maps, &view, share).1.points_in, 0);
}

#[test]
fn what_comes_is_drawn_by_itself_until_it_is_in_the_maps_and_another_light_ends_them() {
    let Some(gpu) = gpu() else { return };
    let mut place = boards(&gpu, DVec3::ZERO);
    let late: BTreeSet<RepId> = place.resident.iter().copied().filter(|rep| rep.0 % 3 == 1).collect();
    place.resident.retain(|rep| !late.contains(rep));
    let mut maps = maps(4.0);
    let view = walk(DVec3::ZERO).next().expect("a view");
    let (early, counts) = place.prepare(&mut maps, &view, AMPLE);
    assert_eq!(counts.maps_drawn, 4);
    // No time to make anything: what is new is drawn beside the maps.
    place.resident.extend(&late);
    let (now, counts) = place.prepare(&mut maps, &view, Share { frames: 0, ..AMPLE });
    assert_eq!(counts.maps_drawn, 4);
    let new = |list: &DrawList| list.items.iter().filter(|item| late.contains(&item.rep)).count();
    let all = place.list(&view).items.iter().filter(|item| late.contains(&item.rep)).count();
    assert_eq!((new(&early), new(&now)), (0, all));
    let (then, counts) = place.prepare(&mut maps, &view, AMPLE);
    assert!(counts.faces_made > 8 && new(&then) <= 1 && then.items.len() < now.items.len(), "{counts:?}");
    // What goes stays in the maps; nothing else may show it.
    place.resident.retain(|rep| !late.contains(rep));
    let (gone, counts) = place.prepare(&mut maps, &view, Share { frames: 0, ..AMPLE });
    assert_eq!((new(&gone), counts.maps_drawn), (0, 4));
    place.renderer.settings().light = Light::Sun { towards: DVec3::Z, ambient: 0.2 };
    let list = place.list(&view);
    let (dark, counts) = place.prepare(&mut maps, &view, Share { frames: 0, ..AMPLE });
    assert_eq!((dark, counts.maps_drawn, counts.faces), (list, 0, 0));
    assert_eq!(place.prepare(&mut maps, &view, AMPLE).1.maps_drawn, 4);
}

#[test]
fn what_cannot_be_made_is_refused_in_words_and_drawn_by_itself() {
    let Some(gpu) = gpu() else { return };
    let mut place = boards(&gpu, DVec3::ZERO);
    let view = walk(DVec3::ZERO).next().expect("a view");
    let list = place.list(&view);
    let mut narrow = maps(4.0);
    let word = "no environment maps: 0.5 MB of memory are left for them; expected at least 0.7 MB";
    let (drawn, counts) = place.prepare(&mut narrow, &view, Share { bytes: 1 << 19, ..AMPLE });
    assert_eq!((drawn, counts.refused.as_deref(), counts.bytes), (list.clone(), Some(word), 0));
    // Room to begin, but not for all: it is found out, said, and not tried again and again.
    let scarce = Share { bytes: 1 << 20, ..AMPLE };
    for is_tried in [true, false] {
        let (drawn, counts) = place.prepare(&mut narrow, &view, scarce);
        assert_eq!((drawn, counts.bytes, counts.points_in > 0), (list.clone(), 0, is_tried));
        assert!(counts.refused.is_some_and(|word| word.starts_with("no environment maps: 1.0 MB")));
    }
    let (_, counts) = place.prepare(&mut narrow, &view, AMPLE);
    assert!(counts.maps_drawn == 4 && counts.bytes > 1 << 20, "{counts:?}");
    // Memory that is taken away ends them.
    assert_eq!(place.prepare(&mut narrow, &view, scarce).0, list);
    // Cells smaller and larger than everything.
    for (side, is_far) in [(1e-3, true), (1e9, false)] {
        let (likeness, counts) = place.likeness(&mut maps(side), &view);
        assert_eq!((counts.maps_drawn, counts.left_out > 0), (4, is_far), "{side}");
        assert!(likeness.ssim > 0.9 && likeness.holes < 2e-3, "{side}: {likeness:?}");
    }
    for side in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let (drawn, counts) = place.prepare(&mut maps(side), &view, AMPLE);
        assert!(drawn == list && counts.refused.is_some_and(|word| word.contains("expected 0.001 to 1e9")), "{side}");
    }
    let lost = View { position: DVec3::splat(1e25), ..view };
    let (_, counts) = place.prepare(&mut maps(4.0), &lost, AMPLE);
    assert!(counts.refused.is_some_and(|word| word.contains("too far from the origin")));
    let mut tinted = place.list(&view);
    tinted.items[0].false_colour = Some([1, 2, 3]);
    let (choose, mut any) = (ChooseSettings::default(), maps(4.0));
    let around = Surroundings { tree: &place.tree, root_sample: None, resident: &place.resident, choose: &choose };
    let drawn = any.prepare(&mut place.renderer, around, &view, &tinted, AMPLE).expect("a list");
    assert!(drawn == tinted && any.counts().refused.is_some());
    // Nothing is there: maps of nothing.
    place.resident.clear();
    let (drawn, counts) = place.prepare(&mut maps(4.0), &view, AMPLE);
    assert_eq!((drawn, counts.maps_drawn, counts.refused), (DrawList::default(), 4, None));
}

#[test]
fn with_a_lost_device_maps_are_lost_and_with_the_next_one_made_anew() {
    let Some(lost) = gpu() else { return };
    let view = walk(DVec3::ZERO).next().expect("a view");
    let mut place = boards(&lost, DVec3::ZERO);
    let mut whole = maps(4.0);
    let (list, counts) = place.prepare(&mut whole, &view, AMPLE);
    let (before, points) = place.picture(&view, &list);
    assert!(counts.maps_drawn == 4 && points > 0, "{counts:?}");
    // Others are being made.
    let mut second = boards(&lost, DVec3::ZERO);
    let little = EnvironmentSettings { points_per_frame: 10_000, ..EnvironmentSettings::with_side(4.0) };
    let mut half = Environment::new(little);
    let share = Share { frames: 1, ..AMPLE };
    for _ in 0..8 {
        second.prepare(&mut half, &view, share);
    }
    assert!(half.counts().faces > 0 && half.counts().maps_drawn == 0, "{:?}", half.counts());
    lost.device.destroy();
    let refused = second.try_prepare(&mut half, &view, share);
    assert!(matches!(refused, Err(GpuError::Lost(_))), "{refused:?}");
    let refused = place.try_prepare(&mut whole, &view, AMPLE);
    assert!(matches!(refused, Err(GpuError::Lost(_))), "{refused:?}");
    let Some(gpu) = gpu() else { return };
    let mut place = boards(&gpu, DVec3::ZERO);
    // Maps are made anew, and those of before are of no use, but no harm, once they are let go.
    whole.clear(&mut place.renderer);
    for maps in [&mut maps(4.0), &mut whole] {
        let (list, again) = place.prepare(maps, &view, AMPLE);
        assert_eq!((again.faces_made, again.left_out), (48, counts.left_out));
        let (after, _) = place.picture(&view, &list);
        assert!(after.rgba == before.rgba && after.distance == before.distance);
        maps.clear(&mut place.renderer);
    }
}
