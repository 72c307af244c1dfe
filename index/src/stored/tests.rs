use super::document::{self, Content, Directions, Document, Input, OctreeParts, Orthoviews};
use super::page::{self, Child, Kind, Leaf, Node, PAGE_MAX, Stored, hash};
use super::publish::Workplace;
use super::{Pages, StoredError, address, open, packing};
use crate::octree::{Cell, Octree};
use crate::orthoview::Direction;
use crate::world::WorldKind;
use foresight_scheduler::benefit::element::ELEMENTS;
use foresight_scheduler::lod_tree::{Aabb, NodeId, RepId};
use glam::DVec3;
use proptest::prelude::*;
use std::path::Path;

const SHARES: u8 = ELEMENTS as u8;

fn octree() -> Octree {
    Octree::over(Aabb { min: DVec3::ZERO, max: DVec3::new(500.0, 500.0, 16.0) }, 16.0).expect("a box")
}

fn stored(cell: Cell, kind: Kind) -> Stored {
    let [x, y, z] = cell.place;
    let seed = x + 64 * y + 4096 * z + 100_000 * u64::from(cell.level);
    Stored {
        kind,
        wire_bytes: 1 + seed as u32,
        decoded_bytes: 4 * (1 + seed as u32),
        error: 0.25 * (1u64 << cell.level) as f32,
        hash: hash(&seed.to_le_bytes()),
        shown: matches!(kind, Kind::Orthoview(_)).then(|| core::array::from_fn(|s| (seed as usize + s) as u8)),
    }
}

/// A tree over the leaves of which `there` says so, packed into pages that `write` takes.
fn tree(
    octree: &Octree,
    cell: Cell,
    there: &impl Fn(Cell) -> bool,
    write: &mut impl FnMut(Cell, &[u8]) -> Result<(), StoredError>,
) -> Option<Node> {
    let top = Direction::from_signs([0, 0, 1]).expect("canonical");
    let mut node =
        Node { cell, representations: vec![stored(cell, Kind::Orthoview(top))], leaf: None, children: Vec::new() };
    if cell.level == 0 {
        if !there(cell) {
            return None;
        }
        node.representations.push(stored(cell, Kind::Geometry(0)));
        let bounds = octree.bounds(cell);
        let mut shares = vec![0; ELEMENTS];
        shares[5] = u16::MAX;
        node.leaf = Some(Leaf { bounds, ground: bounds.min.z, shares });
        return Some(node);
    }
    node.children =
        octree.children(cell).filter_map(|child| tree(octree, child, there, write)).map(Child::Node).collect();
    packing::pack(&mut node, octree, SHARES, write).expect("pages can be written");
    (!node.children.is_empty()).then_some(node)
}

fn document(octree: &Octree, root: String, hash: &page::Hash) -> Document {
    let mut document = Document {
        format: document::FORMAT.to_owned(),
        schema_version: document::SCHEMA_VERSION,
        name: "test".to_owned(),
        identity: String::new(),
        built_by: "a test".to_owned(),
        root,
        catalogue: String::new(),
        up: [0.0, 0.0, 1.0],
        epsg: Some(7415),
        octree: OctreeParts::new(octree),
        orthoviews: Orthoviews {
            pixel: 0.25,
            directions: vec!["oop".to_owned()],
            colour: "webp".to_owned(),
            normals: true,
        },
        directions: Directions {
            within_degrees: 36.3,
            share_not_within: 0.0,
            share_unseen: 0.0,
            largest_degrees: 10.0,
        },
        content: Content::default(),
        inputs: vec![Input { name: "test.glb".to_owned(), identity: "00".to_owned() }],
        left_out: Vec::new(),
        notes: Vec::new(),
        previous: None,
    };
    document.identity = document.identity_of(hash);
    document
}

/// A world of 1024 leaves, published in a folder: its document.
pub(crate) fn published(folder: &Path) -> Document {
    let octree = octree();
    let workplace = Workplace::take(folder).expect("a new folder");
    let mut write = |cell, bytes: &[u8]| workplace.write(&address::page(cell, &hash(bytes)), bytes);
    let root = tree(&octree, octree.root(), &|_| true, &mut write).expect("leaves are there");
    let root = packing::page_of(&Child::Node(root), &octree, SHARES, &mut write).expect("a page can be written");
    let Child::Page(cell, page) = root else { panic!("a page") };
    let document = document(&octree, address::page(cell, &page.hash), &page.hash);
    workplace.publish(&document).expect("a folder that can be written");
    document
}

#[test]
fn a_world_comes_back_from_its_pages() {
    let folder = tempfile::tempdir().expect("a folder");
    let document = published(folder.path());
    let world = open(folder.path()).expect("just published");
    assert_eq!((world.kind, world.georeference), (WorldKind::Built, Some(crate::world::Georeference::Epsg(7415))));
    // 32 × 32 leaves under five levels: 1365 cells, a direction each, and a geometry at the leaves.
    assert_eq!((world.tree.nodes(), world.tree.representations()), (1365, 1365 + 1024));
    let root: Vec<RepId> = world.tree.own(NodeId(0)).collect();
    assert_eq!(root.iter().map(|&rep| world.tree.direction(rep)).collect::<Vec<_>>(), [Some(14)]);
    assert!(world.uri(root[0]).starts_with("orthoviews/5/0_0_0/oop."));
    let leaf = (0..world.tree.nodes() as u32).map(NodeId).find(|&n| world.tree.is_leaf(n)).expect("leaves");
    let names: Vec<_> = world.tree.own(leaf).map(|rep| world.uri(rep).into_owned()).collect();
    assert!(names[0].starts_with("orthoviews/0/0_0_0/") && names[1].starts_with("geometry/0_0_0/0."), "{names:?}");
    assert_eq!(world.tree.bounds(leaf).max, DVec3::splat(16.0).min(DVec3::new(16.0, 16.0, 16.0)));
    assert_eq!(world.ground_height(DVec3::new(8.0, 8.0, 99.0)), Some(0.0));
    let again = super::open_document(folder.path()).expect("a document");
    assert_eq!(again, document);
    let root = std::fs::read(folder.path().join(&again.root)).expect("a page");
    assert_eq!(again.identity, again.identity_of(&hash(&root)));
}

#[test]
fn every_byte_of_a_page_counts() {
    let folder = tempfile::tempdir().expect("a folder");
    let document = published(folder.path());
    let file = folder.path().join(&document.root);
    let whole = std::fs::read(&file).expect("a page");
    for at in (0..whole.len()).step_by(97) {
        let mut bytes = whole.clone();
        bytes[at] ^= 0x41;
        std::fs::write(&file, &bytes).expect("a page");
        let message = open(folder.path()).expect_err("a changed page").to_string();
        assert!(message.contains(".page: byte "), "{message}");
    }
    std::fs::write(&file, &whole[..whole.len() / 2]).expect("a page");
    assert!(open(folder.path()).expect_err("half a page").to_string().contains("the end"));
    std::fs::remove_file(&file).expect("a page");
    assert!(matches!(open(folder.path()), Err(StoredError::Io { .. })));
}

#[test]
fn a_folder_is_taken_once_and_only_if_it_is_ours() {
    let folder = tempfile::tempdir().expect("a folder");
    let first = Workplace::take(folder.path()).expect("an empty folder");
    assert!(matches!(Workplace::take(folder.path()), Err(StoredError::Locked { .. })));
    drop(first);
    drop(Workplace::take(folder.path()).expect("free again"));
    let other = tempfile::tempdir().expect("a folder");
    std::fs::write(other.path().join("letter.txt"), "dear").expect("a file");
    let message = Workplace::take(other.path()).expect_err("somebody else's").to_string();
    assert!(message.contains("holds something else"), "{message}");
    let under_a_file = other.path().join("letter.txt/world");
    assert!(matches!(Workplace::take(&under_a_file), Err(StoredError::Io { .. })));
}

#[test]
fn what_no_version_names_is_swept() {
    let folder = tempfile::tempdir().expect("a folder");
    let document = published(folder.path());
    let workplace = Workplace::take(folder.path()).expect("free");
    workplace.write("nodes/0/0_0_0.0000000000000000.page", b"old").expect("a file");
    workplace.write("orthoviews/0/9_9_9/oop.0000000000000000.fsov", b"old").expect("a file");
    workplace.write("catalogue.0000000000000000.sqlite", b"old").expect("a file");
    assert_eq!(workplace.sweep(&document).expect("a whole world"), 3);
    assert_eq!(workplace.sweep(&document).expect("a whole world"), 0);
    assert!(!folder.path().join("orthoviews/0").exists());
    open(folder.path()).expect("what is named is still there");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn pages_are_small_and_hold_every_leaf(seed: u64, share in 0.0..1.0f64) {
        let octree = octree();
        let folder = tempfile::tempdir().expect("a folder");
        let workplace = Workplace::take(folder.path()).expect("a new folder");
        let there = |cell: Cell| {
            let bytes: Vec<u8> = cell.place.iter().chain([&seed]).flat_map(|v| v.to_le_bytes()).collect();
            f64::from(u16::from_le_bytes([hash(&bytes)[0], hash(&bytes)[1]])) < 65536.0 * share
        };
        let mut largest = 0;
        let root = tree(&octree, octree.root(), &there, &mut |cell, bytes: &[u8]| {
            largest = largest.max(bytes.len());
            workplace.write(&address::page(cell, &hash(bytes)), bytes)
        });
        prop_assert!(largest <= PAGE_MAX);
        let Some(root) = root else { return Ok(()) };
        let bytes = page::encode(&root, &octree, SHARES);
        prop_assert!(bytes.len() <= PAGE_MAX && bytes.len() == 32 + root.size());
        prop_assert_eq!(page::parse(&bytes, &octree), Ok(root.clone()));
        let expected = octree.cells_at(0).into_iter().product::<u64>();
        let counted = (0..expected).map(|i| Cell { level: 0, place: [i % 32, i / 32 % 32, i / 1024] }).filter(|&c| there(c));
        let counted = counted.count() as u64;
        let mut leaves = 0;
        let pages = Pages::new(folder.path(), octree);
        pages.visit::<StoredError>(&root, "root", &mut |node, _| {
            leaves += u64::from(node.leaf.is_some());
            Ok(())
        }).expect("all pages are there");
        prop_assert_eq!((leaves, root.summary().leaves), (counted, counted));
    }

    #[test]
    fn no_bytes_make_the_parser_panic(seed: u64, cut in 0..4000usize, flips in prop::collection::vec((0..4000usize, 0..8u32), 0..4)) {
        let octree = octree();
        let root = tree(&octree, Cell { level: 2, place: [0, 0, 0] }, &|cell| cell.place[0] != seed % 4, &mut |_, _| Ok(()));
        let mut bytes = page::encode(&root.expect("leaves are there"), &octree, SHARES);
        for (at, bit) in flips {
            if let Some(byte) = bytes.get_mut(at) {
                *byte ^= 1 << bit;
            }
        }
        bytes.truncate(cut);
        drop(page::parse(&bytes, &octree));
    }
}

#[cfg(feature = "orthoviews")]
#[test]
fn a_finished_cell_comes_back_to_the_bit_or_not_at_all() {
    use super::checkpoint::{decode, encode};
    use crate::orthoview::{Lattice, Orthoview, Pixel};
    let octree = octree();
    let cell = Cell { level: 2, place: [1, 2, 0] };
    let node = tree(&octree, cell, &|_| true, &mut |_, _| Ok(()));
    let lattice = Lattice {
        direction: Direction::from_signs([1, 1, 1]).expect("canonical"),
        origin: octree.origin(),
        pitch: 0.5,
    };
    let mut image = Orthoview::empty(&lattice, &octree.bounds(cell), cell.level);
    for (index, pixel) in image.pixels.iter_mut().enumerate().filter(|(index, _)| index % 3 != 0) {
        let value = index as f32 / 7.0;
        *pixel = Pixel { depth: value, colour: [value, 0.1, 1.0 / 3.0], normal: [0.0, -value, f32::MIN_POSITIVE] };
    }
    let images = [None, Some(image)];
    let bytes = encode(node.as_ref(), &images, &octree, SHARES);
    let read = decode(&bytes, &octree).expect("just written");
    assert_eq!((read.node, read.images.as_slice()), (node, &images[..]));
    assert_eq!(decode(&bytes[..bytes.len() - 1], &octree), None);
    let mut changed = bytes.clone();
    changed[bytes.len() / 2] ^= 1;
    assert_eq!(decode(&changed, &octree), None);
    assert_eq!(decode(b"", &octree), None);
}
