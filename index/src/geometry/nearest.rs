//! Which of many triangles is nearest to a point: a tree of boxes, halved at the median along their longest axis.

use glam::DVec3;

use crate::mesh::Triangle;
use crate::mesh::triangle::closest;

/// Triangles in a leaf of the tree, at most.
const LEAF: usize = 4;
/// Levels of a tree of 2³² triangles, and room to spare.
const DEPTH: usize = 40;

/// Triangles in the order of the tree's leaves, so that neighbours follow each other.
#[derive(Clone, Debug, Default)]
pub(super) struct Nearest {
    nodes: Vec<Node>,
    triangles: Vec<Triangle>,
    /// Number of each triangle as it was given.
    numbers: Vec<u32>,
}

#[derive(Clone, Copy, Debug)]
struct Node {
    min: DVec3,
    max: DVec3,
    /// First triangle, or the first of two nodes beneath.
    first: u32,
    /// Number of triangles; 0 for an inner node.
    count: u32,
}

impl Node {
    fn square(&self, point: DVec3) -> f64 {
        (self.min - point).max(point - self.max).max(DVec3::ZERO).length_squared()
    }
}

/// What a search found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Found {
    /// Place of the triangle.
    pub(super) place: u32,
    /// Square of its distance.
    pub(super) square: f64,
    /// Whether none is nearer; else the search was ended before.
    pub(super) is_nearest: bool,
}

impl Nearest {
    pub(super) fn over(triangles: Vec<Triangle>) -> Nearest {
        let mut numbers: Vec<u32> = (0..triangles.len() as u32).collect();
        let centres: Vec<DVec3> = triangles.iter().map(|[a, b, c]| (*a + *b + *c) / 3.0).collect();
        let mut tree = Nearest::default();
        if !triangles.is_empty() {
            tree.nodes.push(Node { min: DVec3::ZERO, max: DVec3::ZERO, first: 0, count: triangles.len() as u32 });
            let mut open = vec![0_usize];
            while let Some(index) = open.pop() {
                let node = tree.nodes[index];
                let range = node.first as usize..(node.first + node.count) as usize;
                let part = &mut numbers[range];
                let corners = || part.iter().flat_map(|&t| triangles[t as usize]);
                let min = corners().fold(DVec3::INFINITY, DVec3::min);
                let max = corners().fold(DVec3::NEG_INFINITY, DVec3::max);
                tree.nodes[index] = Node { min, max, ..node };
                if part.len() <= LEAF {
                    continue;
                }
                let spread = |pick: fn(DVec3, DVec3) -> DVec3, start| {
                    part.iter().map(|&t| centres[t as usize]).fold(start, pick)
                };
                let extent = spread(DVec3::max, DVec3::NEG_INFINITY) - spread(DVec3::min, DVec3::INFINITY);
                let axis = (0..3).fold(0, |best, axis| if extent[axis] > extent[best] { axis } else { best });
                let middle = part.len() / 2;
                part.select_nth_unstable_by(middle, |&a, &b| {
                    centres[a as usize][axis].total_cmp(&centres[b as usize][axis]).then(a.cmp(&b))
                });
                let beneath = tree.nodes.len() as u32;
                let half = |first: u32, count: u32| Node { min, max, first, count };
                tree.nodes.push(half(node.first, middle as u32));
                tree.nodes.push(half(node.first + middle as u32, node.count - middle as u32));
                tree.nodes[index] = Node { min, max, first: beneath, count: 0 };
                open.extend([beneath as usize + 1, beneath as usize]);
            }
        }
        tree.triangles = numbers.iter().map(|&t| triangles[t as usize]).collect();
        tree.numbers = numbers;
        tree
    }

    pub(super) fn len(&self) -> usize {
        self.triangles.len()
    }

    /// A triangle and its number, by its place in the tree.
    pub(super) fn at(&self, place: u32) -> (&Triangle, u32) {
        (&self.triangles[place as usize], self.numbers[place as usize])
    }

    /// The triangle nearest to a point, from `hint` on; looks at `visits` nodes at most and takes what they cost off them.
    /// Ends early at a triangle that `suffices`. There must be one.
    pub(super) fn search(
        &self,
        point: DVec3,
        hint: u32,
        visits: &mut u64,
        mut suffices: impl FnMut(u32) -> bool,
    ) -> Found {
        let distance = |place: u32| (closest(&self.triangles[place as usize], point) - point).length_squared();
        let mut found = Found { place: hint, square: distance(hint), is_nearest: false };
        let mut open = [(0.0, 0_u32); DEPTH];
        open[0] = (self.nodes[0].square(point), 0);
        let mut height = 1;
        while height > 0 {
            height -= 1;
            let (square, index) = open[height];
            if square >= found.square {
                continue;
            }
            if *visits == 0 {
                return found;
            }
            *visits -= 1;
            let node = &self.nodes[index as usize];
            if node.count == 0 {
                let [one, other] = [node.first, node.first + 1].map(|n| (self.nodes[n as usize].square(point), n));
                let (near, far) = if other.0 < one.0 { (other, one) } else { (one, other) };
                for next in [far, near] {
                    if next.0 < found.square && height < DEPTH {
                        open[height] = next;
                        height += 1;
                    }
                }
                continue;
            }
            for place in node.first..node.first + node.count {
                let square = distance(place);
                if square < found.square {
                    found = Found { place, square, is_nearest: false };
                    if suffices(place) {
                        return found;
                    }
                }
            }
        }
        Found { is_nearest: true, ..found }
    }
}
