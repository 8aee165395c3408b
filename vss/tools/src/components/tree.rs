//! Components and their holes as a tree: which hole a component lies in, and which component a hole is of.
//!
//! The background is connected the other way, so every region has one region around it: the one left of its first pixel
//! (A. Rosenfeld, Connectivity in digital pictures, JACM 17, 1970). Background that reaches the border is outside of all.

use super::{Component, Connectivity, Forest, Run, find_runs};

/// A component, or a hole in one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Region {
    /// Its pixels. Those of a hole have an Euler number, too: one minus the components in it.
    pub component: Component,
    /// It is background that a component encloses.
    pub hole: bool,
    /// The region around it, by its index: the component of a hole, the hole of a component. Nothing around it: `None`.
    pub parent: Option<usize>,
}

/// All components of the pixels that are at least `threshold`, and their holes, in the order of their first pixels.
///
/// A region comes after the one around it. Rows are as in [`components`](super::components). None when more than about `most`
/// parts of components, or of the background, begin.
#[must_use]
pub fn regions(
    pixels: &[u8],
    width: usize,
    threshold: u8,
    connectivity: Connectivity,
    most: usize,
) -> Option<Vec<Region>> {
    if width == 0 {
        return Some(Vec::new());
    }
    let other = match connectivity {
        Connectivity::Four => Connectivity::Eight,
        Connectivity::Eight => Connectivity::Four,
    };
    let (mut bright, mut dark) = (Side::new(connectivity), Side::new(other));
    for (row, line) in pixels.chunks_exact(width).enumerate() {
        find_runs(line, threshold, &mut bright.here);
        gaps(line, &bright.here, &mut dark.here);
        bright.forest.connect(&bright.above, &mut bright.here, row);
        dark.forest.connect(&dark.above, &mut dark.here, row);
        bright.note_lefts(&dark.here);
        dark.note_lefts(&bright.here);
        bright.next_row();
        dark.next_row();
        if bright.lefts.len().max(dark.lefts.len()) > most {
            return None;
        }
    }
    Some(nested(bright, dark, (width, pixels.len() / width)))
}

/// The foreground, or the background.
struct Side {
    forest: Forest,
    above: Vec<Run>,
    here: Vec<Run>,
    /// For each label the label of the other side's run left of its first pixel; none at the border.
    lefts: Vec<Option<usize>>,
}

impl Side {
    fn new(connectivity: Connectivity) -> Self {
        Self {
            forest: Forest::new(connectivity),
            above: Vec::new(),
            here: Vec::new(),
            lefts: Vec::new(),
        }
    }

    /// What is left of the parts that begin in this row. Labels are given in the order of runs.
    fn note_lefts(&mut self, others: &[Run]) {
        for run in &self.here {
            if run.label == self.lefts.len() {
                let left = others.binary_search_by_key(&run.start, |other| other.end);
                let left = left.ok().and_then(|index| others.get(index));
                self.lefts.push(left.map(|other| other.label));
            }
        }
    }

    fn next_row(&mut self) {
        std::mem::swap(&mut self.above, &mut self.here);
        self.here.clear();
    }
}

/// The runs between the runs of a row.
fn gaps(line: &[u8], runs: &[Run], between: &mut Vec<Run>) {
    let mut start = 0;
    let ends = runs.iter().map(|run| (run.start, run.end));
    for (end, next) in ends.chain([(line.len(), line.len())]) {
        let pixels = line.get(start..end).unwrap_or_default();
        let brightest = pixels.iter().copied().max();
        if let Some(peak) = brightest {
            let first = pixels.iter().position(|pixel| *pixel == peak);
            between.push(Run {
                start,
                end,
                peak,
                peak_at: start + first.unwrap_or_default(),
                label: 0,
            });
        }
        start = next;
    }
}

fn nested(bright: Side, dark: Side, (width, height): (usize, usize)) -> Vec<Region> {
    let outside = |part: &Component| {
        part.u_min == 0 || part.v_min == 0 || part.u_max + 1 == width || part.v_max + 1 == height
    };
    let (components, component_of) = bright.forest.settled();
    let (spaces, space_of) = dark.forest.settled();
    // Both lists as one, in the order of first pixels, without the outside.
    let all = components.iter().map(|(label, part)| (false, *label, part));
    let holes = spaces.iter().filter(|(_, part)| !outside(part));
    let mut order: Vec<(bool, usize, &Component)> = all
        .chain(holes.map(|(label, part)| (true, *label, part)))
        .collect();
    order.sort_by_key(|(_, _, part)| (part.first.1, part.first.0));
    let mut index_of = [vec![None; component_of.len()], vec![None; space_of.len()]];
    for (index, (hole, label, _)) in order.iter().enumerate() {
        index_of[usize::from(*hole)][*label] = Some(index);
    }
    let parent = |hole: bool, label: usize| {
        let (lefts, roots) = if hole {
            (&dark.lefts, &component_of)
        } else {
            (&bright.lefts, &space_of)
        };
        let root = *roots.get((*lefts.get(label)?)?)?;
        *index_of[usize::from(!hole)].get(root)?
    };
    let regions = order.iter().map(|&(hole, label, part)| Region {
        component: part.clone(),
        hole,
        parent: parent(hole, label),
    });
    regions.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn tree(rows: &[&str], connectivity: Connectivity) -> Vec<(bool, u64, Option<usize>)> {
        let pixels: Vec<u8> = rows.concat().bytes().map(|b| u8::from(b == b'#')).collect();
        let found = regions(&pixels, rows[0].len(), 1, connectivity, 100).unwrap();
        let short = |one: &Region| (one.hole, one.component.area, one.parent);
        found.iter().map(short).collect()
    }

    #[test]
    fn rings_in_rings_are_a_chain_and_what_lies_beside_them_is_not() {
        let rows = [
            "#######.....",
            "#.....#.....",
            "#.###.#..##.",
            "#.#.#.#..##.",
            "#.###.#.....",
            "#.....#.....",
            "#######.....",
        ];
        let expected = [
            (false, 24, None),
            (true, 16, Some(0)),
            (false, 8, Some(1)),
            (false, 4, None),
            (true, 1, Some(2)),
        ];
        assert_eq!(tree(&rows, Connectivity::Eight), expected);
    }

    #[test]
    fn a_diagonal_gap_opens_a_hole_only_where_four_neighbours_count() {
        let rows = [".....", ".##..", ".#.#.", ".###.", "....."];
        assert_eq!(
            tree(&rows, Connectivity::Eight),
            [(false, 7, None), (true, 1, Some(0))]
        );
        // The background is connected across the corner.
        assert_eq!(tree(&rows, Connectivity::Four), [(false, 7, None)]);
    }

    /// Pixels that are reached from `from` without a step into `wall`; steps over corners only if `corners`.
    fn reached(from: usize, wall: &[bool], width: usize, corners: bool) -> Vec<bool> {
        let height = wall.len() / width;
        let mut seen = vec![false; wall.len()];
        seen[from] = true;
        let mut stack = vec![from];
        while let Some(at) = stack.pop() {
            let (u, v) = ((at % width) as i64, (at / width) as i64);
            for (du, dv) in (-1..=1).flat_map(|du| (-1..=1).map(move |dv| (du, dv))) {
                let (x, y) = (u + du, v + dv);
                let inside = (0..width as i64).contains(&x) && (0..height as i64).contains(&y);
                if (du != 0 && dv != 0 && !corners) || !inside {
                    continue;
                }
                let next = y as usize * width + x as usize;
                if !wall[next] && !seen[next] {
                    seen[next] = true;
                    stack.push(next);
                }
            }
        }
        seen
    }

    proptest! {
        /// Without the pixels of its parent, nothing leads from a region to the border; and they touch.
        #[test]
        fn a_parent_is_what_encloses_a_region_and_touches_it(
            width in 1_usize..24,
            pixels in prop::collection::vec(prop::sample::select(vec![0_u8, 0, 1]), 1..500),
            inverse in any::<bool>(),
            corners in any::<bool>(),
        ) {
            let whole = pixels.len() / width * width;
            let pixels: Vec<u8> = pixels[..whole].iter().map(|p| if inverse { 1 - p } else { *p }).collect();
            let connectivity = if corners { Connectivity::Eight } else { Connectivity::Four };
            let found = regions(&pixels, width, 1, connectivity, 1000).unwrap();
            let members = |region: &Region| {
                let own = u8::from(!region.hole);
                let wall: Vec<bool> = pixels.iter().map(|pixel| *pixel != own).collect();
                let (u, v) = region.component.first;
                reached(v * width + u, &wall, width, corners != region.hole)
            };
            let on_border = |at: usize| {
                let (u, v) = (at % width, at / width);
                u == 0 || v == 0 || u + 1 == width || v + 1 == whole / width
            };
            for (index, region) in found.iter().enumerate() {
                let own = members(region);
                prop_assert_eq!(own.iter().filter(|one| **one).count() as u64, region.component.area);
                let holes = found.iter().filter(|other| other.parent == Some(index)).count() as i64;
                prop_assert_eq!(holes, 1 - region.component.euler);
                let (u, v) = region.component.first;
                let first = v * width + u;
                match region.parent {
                    Some(parent) => {
                        prop_assert!(parent < index && found[parent].hole != region.hole);
                        let wall = members(&found[parent]);
                        // A parent that is connected over sides is crossed over corners, and the other way round.
                        let open = reached(first, &wall, width, corners != region.hole);
                        prop_assert!(!(0..whole).any(|at| open[at] && on_border(at)));
                        prop_assert!(wall[first - 1]);
                    }
                    None => prop_assert!(!region.hole),
                }
            }
            let all: u64 = found.iter().filter(|one| !one.hole).map(|one| one.component.area).sum();
            prop_assert_eq!(all, pixels.iter().map(|pixel| u64::from(*pixel)).sum::<u64>());
        }
    }
}
