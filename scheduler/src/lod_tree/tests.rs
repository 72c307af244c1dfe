use super::*;
use crate::benefit::element::{HIDDEN, errors};

fn rep(wire_bytes: u32, error: f32) -> Representation {
    Representation { wire_bytes, decoded_bytes: 4 * wire_bytes, error, prerequisite: None, direction: None }
}

fn unit(x: f64) -> Aabb {
    Aabb { min: DVec3::new(x, 0.0, 0.0), max: DVec3::new(x + 1.0, 1.0, 1.0) }
}

#[test]
fn preorder_intervals_and_areas() -> Result<(), LodTreeError> {
    let mut b = LodTreeBuilder::default();
    let root = b.open()?;
    let coarse = b.add(rep(10, 4.0))?;
    let left = b.open()?;
    b.add(rep(20, 1.0))?;
    b.close(Some(unit(0.0)), 1.0)?;
    let middle = b.open()?;
    let far = b.open()?;
    b.add(rep(30, 1.0))?;
    b.close(Some(unit(5.0)), 2.0)?;
    b.close(None, 1.0)?;
    b.close(None, 1.0)?;
    let tree = b.finish()?;
    assert_eq!(tree.children(root).collect::<Vec<_>>(), [left, middle]);
    assert_eq!(tree.face_areas(root), DVec3::splat(3.0));
    assert_eq!(tree.bounds(root), Aabb { min: DVec3::ZERO, max: DVec3::new(6.0, 1.0, 1.0) });
    assert_eq!(tree.ancestors(far).collect::<Vec<_>>(), [far, middle, root]);
    assert_eq!(tree.content_parent(far), Some(root));
    assert_eq!(tree.sibling_group(Some(root)), [left, far]);
    assert_eq!(tree.sibling_group(None), [root]);
    assert_eq!(tree.beneath(root).len(), 3);
    assert_eq!(tree.own(root).next(), Some(coarse));
    assert!(!tree.has_prerequisites() && !tree.has_directions());
    // Beneath the root: 1 m² a 20 bytes and 2 m² a 30 bytes, to a hundredth and never less.
    let bounds = tree.beneath_bounds(root);
    assert!(bounds.density.iter().all(|&d| (2.0 / 30.0..2.0 / 30.0 * 1.01).contains(&f64::from(d))));
    assert!(bounds.least_error == 1.0 && bounds.least_wire == 20.0);
    assert_eq!(tree.beneath_bounds(far), Beneath::NONE);
    Ok(())
}

#[test]
fn boxes_far_from_the_origin_keep_the_millimetre() -> Result<(), LodTreeError> {
    let mut b = LodTreeBuilder::default();
    let content = Aabb { min: DVec3::new(6.4e6, 0.001, 0.0), max: DVec3::new(6.4e6 + 0.003, 0.002, 1.0) };
    b.open()?;
    b.add(rep(1, 0.0))?;
    b.close(Some(content), 1.0)?;
    let bounds = b.finish()?.bounds(NodeId(0));
    assert!((bounds.min - content.min).abs().max_element() < 1e-6);
    assert!(bounds.min.cmple(content.min).all() && bounds.max.cmpge(content.max).all());
    Ok(())
}

#[test]
fn refuses_what_it_cannot_bound() {
    let mut b = LodTreeBuilder::default();
    assert_eq!(b.close(None, 1.0), Err(LodTreeError::Nesting("close without open")));
    b.open().unwrap();
    assert!(matches!(b.add(rep(1, f32::NAN)), Err(LodTreeError::GeometricError { .. })));
    assert_eq!(b.add(rep(0, 1.0)), Err(LodTreeError::NoBytes(0)));
    assert_eq!(b.close(None, 1.0), Err(LodTreeError::LeafWithoutBounds(0)));
    assert!(matches!(LodTreeBuilder::default().finish(), Err(LodTreeError::Empty)));
}

#[test]
fn a_tree_too_deep_to_walk_is_refused() -> Result<(), LodTreeError> {
    let mut b = LodTreeBuilder::default();
    for _ in 0..DEPTH_MAX {
        b.open()?;
    }
    assert_eq!(b.open(), Err(LodTreeError::TooDeep));
    b.add(rep(1, 0.0))?;
    b.close(Some(unit(0.0)), 1.0)?;
    for _ in 1..DEPTH_MAX {
        b.close(None, 1.0)?;
    }
    assert_eq!(b.finish()?.ancestors(NodeId(DEPTH_MAX as u32 - 1)).count(), DEPTH_MAX);
    Ok(())
}

#[test]
fn surfaces_are_summed_and_kept_only_with_directions() -> Result<(), LodTreeError> {
    let build = |direction| -> Result<LodTree, LodTreeError> {
        let mut b = LodTreeBuilder::default();
        b.open()?;
        b.add(Representation { direction, ..rep(10, 4.0) })?;
        b.open()?;
        let mut shares = [0.0; ELEMENTS];
        (shares[5], shares[13]) = (3.0, 1.0);
        b.surface(shares)?;
        b.close(Some(unit(0.0)), 2.0)?;
        b.open()?;
        b.close(Some(unit(5.0)), 1.0)?;
        assert!(matches!(b.surface([f32::NAN; ELEMENTS]), Err(LodTreeError::Surface { node: 0, .. })));
        assert!(matches!(b.surface([0.0; ELEMENTS]), Err(LodTreeError::Surface { node: 0, .. })));
        b.close(None, 1.0)?;
        b.finish()
    };
    let (with, without) = (build(Some(14))?, build(None)?);
    // Six faces of 1 m², twice as important, three quarters of them facing up; then the faces of a cube.
    let (told, default) = (with.surface(NodeId(1)), with.surface(NodeId(2)));
    assert!(told[5] == 9.0 && told[13] == 3.0 && told.iter().sum::<f64>() == 12.0);
    assert!(default[..6] == [1.0; 6] && default[6..] == [0.0; 8]);
    assert!((0..ELEMENTS).all(|s| with.surface(NodeId(0))[s] == told[s] + default[s]));
    assert_eq!(without.surface(NodeId(1))[..6], [2.0; 6]);
    assert_eq!(with.heap_bytes() - without.heap_bytes(), 1 + 3 * 4 * ELEMENTS);
    Ok(())
}

#[test]
fn what_orthoviews_hide_is_told_of_them_alone_and_kept_only_where_told() -> Result<(), LodTreeError> {
    let build = |told: bool| -> Result<LodTree, LodTreeError> {
        let mut b = LodTreeBuilder::default();
        b.open()?;
        assert!(matches!(b.shown([0; ELEMENTS]), Err(LodTreeError::Nesting(_))));
        b.add(Representation { direction: Some(14), ..rep(10, 4.0) })?;
        b.add(Representation { direction: Some(14), ..rep(10, 2.0) })?;
        let mut shown = [HIDDEN; ELEMENTS];
        (shown[5], shown[13]) = (0, 32);
        if told {
            // The last word counts.
            b.shown([7; ELEMENTS])?;
            b.shown(shown)?;
        }
        b.add(rep(10, 0.0))?;
        assert!(matches!(b.shown(shown), Err(LodTreeError::Nesting(_))));
        b.close(Some(unit(0.0)), 1.0)?;
        b.finish()
    };
    let (with, without) = (build(true)?, build(false)?);
    let [above, told, mesh] = [0, 1, 2].map(|rep| errors(&with, RepId(rep)));
    assert!(told[5] == 2.0 && told[13] == 8.0 && told.iter().filter(|error| error.is_finite()).count() == 2);
    // What does not tell is as it would be without, rounded up to a code.
    for (s, (coded, exact)) in above.into_iter().zip(errors(&without, RepId(0))).enumerate() {
        assert!(coded == exact || (exact..=1.0443 * exact).contains(&coded), "{s}: {coded} {exact}");
    }
    assert_eq!(mesh, [0.0; ELEMENTS]);
    assert_eq!(without.shown(RepId(1)), None);
    assert_eq!(with.heap_bytes() - without.heap_bytes(), 3 * ELEMENTS);
    Ok(())
}
