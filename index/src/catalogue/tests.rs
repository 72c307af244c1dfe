use super::{Catalogue, CatalogueError, Location};
use crate::stored::document::Document;
use crate::stored::tests::published;
use crate::stored::{self, Pages};
use foresight_scheduler::lod_tree::{Aabb, NodeId};
use glam::DVec3;
use std::path::Path;
use std::time::Duration;

#[cfg(feature = "postgres")]
#[expect(unreachable_pub, reason = "the same file is a public module of the end-to-end tests")]
#[path = "../../../tests/src/postgres.rs"]
mod server;

const PATIENCE: Duration = Duration::from_secs(10);

fn pages(folder: &Path, document: &Document) -> Pages {
    Pages::new(folder, document.octree.octree().expect("parts of an octree"))
}

/// Publishes a world under three identities and asks for its cells.
fn publish_and_ask(location: &Location) {
    let folder = tempfile::tempdir().expect("a folder");
    let document = published(folder.path());
    let pages = pages(folder.path(), &document);
    for first in ['a', 'b', 'c', 'c'] {
        let identity = first.to_string() + &document.identity[1..];
        let version = Document { identity, ..document.clone() };
        Catalogue::publish(location, &version, &pages, PATIENCE).expect("published");
    }
    let mut catalogue = Catalogue::open(location, PATIENCE).expect("just written");
    let worlds = catalogue.worlds().expect("readable");
    let identities: String = worlds.iter().map(|(identity, _)| &identity[..1]).collect();
    assert_eq!(identities, "bc", "the newest and the one before");

    let (identity, world) = (&worlds[1].0, stored::open(folder.path()).expect("a world"));
    let asked = Aabb { min: DVec3::new(100.0, 30.0, -5.0), max: DVec3::new(160.5, 31.0, 5.0) };
    for levels in [0..=0, 1..=3, 0..=40, 6..=9] {
        let found = catalogue.cells(identity, &asked, levels.clone()).expect("readable");
        let meets = |b: Aabb| b.min.cmple(asked.max).all() && b.max.cmpge(asked.min).all();
        let height = |node: NodeId| 5 - (world.tree.ancestors(node).count() as u32 - 1);
        let expected = (0..world.tree.nodes() as u32).map(NodeId);
        let expected = expected.filter(|&n| levels.contains(&height(n)) && meets(world.tree.bounds(n))).count();
        assert_eq!(found.len(), expected, "{levels:?}");
        assert!(found.iter().all(|cell| meets(cell.bounds) && levels.contains(&(cell.level as u32))));
        assert!(found.iter().all(|cell| folder.path().join(&cell.page).exists()));
    }
    let root = catalogue.cells(identity, &asked, 5..=5).expect("readable");
    assert_eq!((root[0].id, root[0].parent, root[0].place), (0, None, [0; 3]));
    let leaf = catalogue.cells(identity, &asked, 0..=0).expect("readable")[0].clone();
    let shown = catalogue.representations(identity, &[root[0].id, leaf.id]).expect("readable");
    let told: Vec<_> = shown.iter().map(|rep| (rep.cell, rep.direction.as_deref(), rep.detail, rep.error)).collect();
    assert_eq!(told, [(0, Some("oop"), None, 8.0), (leaf.id, Some("oop"), None, 0.25), (leaf.id, None, Some(0), 0.25)]);
    assert!(shown[2].file.starts_with("geometry/") && shown[0].wire_bytes > 0);
    let absent = catalogue.cells("0000", &asked, 0..=0);
    assert!(matches!(absent, Err(CatalogueError::Absent { .. })), "{absent:?}");
}

#[test]
fn a_file_answers_for_a_box() {
    let folder = tempfile::tempdir().expect("a folder");
    publish_and_ask(&Location::File(folder.path().join("catalogue.sqlite")));
}

#[cfg(feature = "postgres")]
#[test]
fn a_server_answers_for_a_box() {
    if std::env::var_os("FORESIGHT_FULL").is_none_or(|value| value != "1") {
        println!("skipped: needs tests/run --full");
        return;
    }
    let server = server::Server::start();
    publish_and_ask(&server.url().parse().expect("a location"));
}

#[test]
fn what_is_no_catalogue_or_a_newer_one_is_refused_by_name() {
    let folder = tempfile::tempdir().expect("a folder");
    let open = |name: &str| Catalogue::open(&Location::File(folder.path().join(name)), PATIENCE).map(drop);
    let absent = open("absent.sqlite");
    assert!(matches!(absent, Err(CatalogueError::ReadOnly { .. })), "{absent:?}");
    std::fs::write(folder.path().join("letter.sqlite"), [b'x'; 4096]).expect("a file");
    let letter = open("letter.sqlite");
    assert!(matches!(letter, Err(CatalogueError::Damaged { .. })), "{letter:?}");
    std::fs::write(folder.path().join("empty.sqlite"), "").expect("a file");
    let empty = open("empty.sqlite");
    assert!(matches!(empty, Err(CatalogueError::None { .. })), "{empty:?}");

    let location = Location::File(folder.path().join("newer.sqlite"));
    let mut catalogue = Catalogue::create(&location, PATIENCE).expect("made");
    let newer = "INSERT INTO catalogue_migrations (version, description, success, checksum, execution_time) \
                 VALUES (99, 'of tomorrow', true, x'00', 0)";
    catalogue.within(async |connection| connection.execute(newer, &[]).await).expect("written");
    drop(catalogue);
    let message = open("newer.sqlite").expect_err("newer").to_string();
    assert!(message.contains("newer.sqlite has schema version 99; expected 1"), "{message}");
    #[cfg(not(feature = "postgres"))]
    assert!(matches!(
        Catalogue::open(&Location::Postgres("postgres://x/y".to_owned()), PATIENCE),
        Err(CatalogueError::WithoutPostgres { .. })
    ));
}

#[test]
fn a_damaged_page_leaves_the_catalogue_as_it_was() {
    let folder = tempfile::tempdir().expect("a folder");
    let document = published(folder.path());
    let location = Location::File(folder.path().join("c.sqlite"));
    Catalogue::publish(&location, &document, &pages(folder.path(), &document), PATIENCE).expect("published");
    std::fs::write(folder.path().join(&document.root), "nothing").expect("a file");
    let changed = Document { identity: "9".repeat(64), ..document.clone() };
    let refused = Catalogue::publish(&location, &changed, &pages(folder.path(), &document), PATIENCE);
    assert!(matches!(refused, Err(CatalogueError::Stored(_))), "{refused:?}");
    let mut catalogue = Catalogue::open(&location, PATIENCE).expect("as it was");
    assert_eq!(catalogue.worlds().expect("readable"), [(document.identity, document.name)]);
}
