//! A face's blocks, and the order of their points in its list.

use std::ops::Range;

/// Blocks along a face's side: `BLOCKS` of environment.wgsl.
pub(super) const BLOCKS: u32 = 16;
pub(super) const BLOCK_COUNT: usize = (BLOCKS * BLOCKS) as usize;

/// A face is drawn in quarters of 4 × 4 tiles, each of 2 × 2 blocks.
pub(super) const QUARTERS: usize = 4;

/// `Block` of environment.wgsl.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Block {
    pub(super) points: u32,
    pub(super) least: u32,
    pub(super) most: u32,
}

/// Column and row of a tile among the face's 8 × 8.
pub(super) fn corner(quarter: usize, tile: usize) -> [u32; 2] {
    [4 * (quarter % 2) + tile % 4, 4 * (quarter / 2) + tile / 4].map(|at| at as u32)
}

/// The numbers of a tile's four blocks.
fn tile_blocks([column, row]: [u32; 2]) -> [usize; 4] {
    core::array::from_fn(|at| ((2 * row as usize + at / 2) * BLOCKS as usize) + 2 * column as usize + at % 2)
}

/// A tile's blocks as one.
pub(super) fn merged(blocks: &[Block], tile: [u32; 2]) -> Block {
    let mut all = Block { points: 0, least: 65_535, most: 0 };
    for block in tile_blocks(tile).map(|number| blocks[number]).iter().filter(|block| block.points > 0) {
        all.points += block.points;
        all.least = all.least.min(block.least);
        all.most = all.most.max(block.most);
    }
    all
}

/// Where each block's points begin in the list, the ranges of the tiles of each quarter, and how many points there are.
pub(super) fn layout(blocks: &[Block]) -> ([u32; BLOCK_COUNT], [[Range<u32>; 16]; QUARTERS], u32) {
    let mut starts = [0; BLOCK_COUNT];
    let mut points = 0;
    let ranges = core::array::from_fn(|quarter| {
        core::array::from_fn(|tile| {
            let first = points;
            for number in tile_blocks(corner(quarter, tile)) {
                starts[number] = points;
                points += blocks[number].points;
            }
            first..points
        })
    });
    (starts, ranges, points)
}

/// As the GPU counted them.
pub(super) fn read(answer: &wgpu::Buffer) -> Option<Vec<Block>> {
    let mapped = answer.get_mapped_range(..).ok()?;
    let words: Vec<u32> = mapped.as_chunks::<4>().0.iter().map(|word| u32::from_le_bytes(*word)).collect();
    let blocks = words.as_chunks::<3>().0.iter().map(|&[points, least, most]| Block { points, least, most });
    Some(blocks.collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_have_every_block_once_and_tiles_in_ranges() {
        let block = |number: usize| Block { points: number as u32 % 7, least: 1 + number as u32, most: 500 };
        let blocks: Vec<Block> = (0..BLOCK_COUNT).map(block).collect();
        let (starts, ranges, points) = layout(&blocks);
        assert_eq!(points, blocks.iter().map(|block| block.points).sum::<u32>());
        let mut taken = vec![0; points as usize];
        for (start, block) in starts.into_iter().zip(&blocks) {
            taken[start as usize..(start + block.points) as usize].iter_mut().for_each(|times| *times += 1);
        }
        assert!(taken.iter().all(|&times| times == 1));
        let all: Vec<Range<u32>> = ranges.into_iter().flatten().collect();
        assert!(all.windows(2).all(|pair| pair[0].end == pair[1].start) && all[63].end == points);
        // The last tile of the second quarter: columns 14 and 15, rows 6 and 7.
        assert_eq!(corner(1, 15), [7, 3]);
        let numbers = [6 * 16 + 14, 6 * 16 + 15, 7 * 16 + 14, 7 * 16 + 15];
        assert_eq!(tile_blocks([7, 3]), numbers);
        let within = merged(&blocks, [7, 3]);
        assert_eq!(within.points, numbers.iter().map(|&number| blocks[number].points).sum::<u32>());
        assert_eq!((all[31].end - all[31].start, within.most), (within.points, 500));
        let nothing = vec![Block { points: 0, least: 65_535, most: 0 }; BLOCK_COUNT];
        assert_eq!((layout(&nothing).2, merged(&nothing, [0, 0])), (0, nothing[0]));
    }
}
