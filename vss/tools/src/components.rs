//! Connected components of a thresholded picture by runs, with exact moments in closed form.
//!
//! No label image is made: each row becomes runs of foreground pixels, a run joins the components of
//! the runs it touches in the row above, and every sum over a run has a closed form.
//! Sums are integers, so areas, centroids and second moments are exact whatever the size. Components
//! come in the order of their first pixel, row by row. This module knows grey values and nothing of
//! spots, cameras or tasks.

mod expectation;
mod tree;

pub use expectation::{Doubt, Expectation};
pub use tree::{Region, regions};

/// Bytes that are looked at together when background is skipped.
const STRIDE: usize = 64;

/// Which neighbours of a pixel belong to its component. The background between is connected the other way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Connectivity {
    /// Those that share a side.
    Four,
    /// Those that share a side or a corner.
    #[default]
    Eight,
}

/// One connected set of foreground pixels.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Component {
    /// The first pixel in raster order, (u, v).
    pub first: (usize, usize),
    /// Number of pixels.
    pub area: u64,
    /// Smallest column.
    pub u_min: usize,
    /// Largest column, included.
    pub u_max: usize,
    /// Smallest row.
    pub v_min: usize,
    /// Largest row, included.
    pub v_max: usize,
    /// The largest grey value.
    pub peak: u8,
    /// The first pixel, in raster order, that has the largest grey value, (u, v).
    pub peak_at: (usize, usize),
    /// One minus the number of holes.
    pub euler: i64,
    sum_u: u64,
    sum_v: u64,
    sum_uu: u128,
    sum_uv: u128,
    sum_vv: u128,
}

/// Second central moments of a component: means (not sums) of du², du dv and dv², px².
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moments {
    /// Mean of du².
    pub uu: f64,
    /// Mean of du dv.
    pub uv: f64,
    /// Mean of dv².
    pub vv: f64,
}

impl Moments {
    /// The eigenvalues, larger first, px². Twice their roots are the half-axes of the equivalent ellipse.
    #[must_use]
    pub fn eigenvalues(&self) -> (f64, f64) {
        let middle = 0.5 * (self.uu + self.vv);
        let half = (0.25 * (self.uu - self.vv).powi(2) + self.uv * self.uv).sqrt();
        (middle + half, (middle - half).max(0.0))
    }

    /// The direction of the longer axis, rad, in (-π/2, π/2], from u towards v.
    #[must_use]
    pub fn orientation(&self) -> f64 {
        0.5 * (2.0 * self.uv).atan2(self.uu - self.vv)
    }

    /// √(1 - l2/l1) of the eigenvalues l1 ≥ l2: 0 for a disc, towards 1 for a line. 0 for a single pixel.
    #[must_use]
    pub fn eccentricity(&self) -> f64 {
        let (long, short) = self.eigenvalues();
        if long > 0.0 {
            (1.0 - short / long).max(0.0).sqrt()
        } else {
            0.0
        }
    }
}

impl Component {
    fn new(run: &Run, row: usize) -> Self {
        let mut component = Self {
            first: (run.start, row),
            area: 0,
            u_min: run.start,
            u_max: run.end - 1,
            v_min: row,
            v_max: row,
            peak: run.peak,
            peak_at: (run.peak_at, row),
            euler: 0,
            sum_u: 0,
            sum_v: 0,
            sum_uu: 0,
            sum_uv: 0,
            sum_vv: 0,
        };
        component.add_run(run, row);
        component
    }

    fn add_run(&mut self, run: &Run, row: usize) {
        let (a, b, v) = (run.start as u64, run.end as u64, row as u64);
        let n = b - a;
        // The sum of a..b-1; n and (a + b - 1) cannot both be odd.
        let sum_u = n * (a + b - 1) / 2;
        self.area += n;
        self.euler += 1;
        self.sum_u += sum_u;
        self.sum_v += n * v;
        self.sum_uu += squares_below(b) - squares_below(a);
        self.sum_uv += u128::from(sum_u) * u128::from(v);
        self.sum_vv += u128::from(n) * u128::from(v) * u128::from(v);
        self.u_min = self.u_min.min(run.start);
        self.u_max = self.u_max.max(run.end - 1);
        self.v_max = self.v_max.max(row);
        if run.peak > self.peak {
            self.peak = run.peak;
            self.peak_at = (run.peak_at, row);
        }
    }

    /// Takes in another component whose first pixel comes later in raster order.
    fn absorb(&mut self, other: &Self) {
        self.area += other.area;
        self.euler += other.euler;
        self.sum_u += other.sum_u;
        self.sum_v += other.sum_v;
        self.sum_uu += other.sum_uu;
        self.sum_uv += other.sum_uv;
        self.sum_vv += other.sum_vv;
        self.u_min = self.u_min.min(other.u_min);
        self.u_max = self.u_max.max(other.u_max);
        self.v_min = self.v_min.min(other.v_min);
        self.v_max = self.v_max.max(other.v_max);
        let earlier = (other.peak_at.1, other.peak_at.0) < (self.peak_at.1, self.peak_at.0);
        if other.peak > self.peak || (other.peak == self.peak && earlier) {
            self.peak = other.peak;
            self.peak_at = other.peak_at;
        }
    }

    /// The unweighted centroid (u, v), px.
    #[must_use]
    pub fn centroid(&self) -> (f64, f64) {
        let n = self.area as f64;
        (self.sum_u as f64 / n, self.sum_v as f64 / n)
    }

    /// The second central moments. The subtraction is done in integers, so nothing cancels.
    #[must_use]
    pub fn moments(&self) -> Moments {
        let n = u128::from(self.area);
        let (u, v) = (u128::from(self.sum_u), u128::from(self.sum_v));
        let square = n as f64 * n as f64;
        // n Σu² >= (Σu)² and n Σv² >= (Σv)² always (Cauchy-Schwarz); the mixed one may be negative.
        let mixed = (n * self.sum_uv) as i128 - (u * v) as i128;
        Moments {
            uu: (n * self.sum_uu - u * u) as f64 / square,
            uv: mixed as f64 / square,
            vv: (n * self.sum_vv - v * v) as f64 / square,
        }
    }
}

/// The sum of k² for k < n: (n-1) n (2n-1) / 6.
fn squares_below(n: u64) -> u128 {
    // 128 bits are divided by a call, twice for each run.
    if n < 1 << 21 {
        return u128::from(n.saturating_sub(1) * n * (2 * n).saturating_sub(1) / 6);
    }
    let n = u128::from(n);
    n.saturating_sub(1) * n * (2 * n).saturating_sub(1) / 6
}

#[derive(Debug, Clone, Copy)]
struct Run {
    start: usize,
    end: usize,
    peak: u8,
    peak_at: usize,
    label: usize,
}

impl Run {
    fn new(line: &[u8], start: usize, end: usize) -> Self {
        let (mut peak, mut peak_at) = (0, start);
        for (at, &value) in line.iter().enumerate().take(end).skip(start) {
            if value > peak {
                (peak, peak_at) = (value, at);
            }
        }
        Self {
            start,
            end,
            peak,
            peak_at,
            label: 0,
        }
    }
}

/// The 8-connected components of all pixels that are at least `threshold`, in the order of their first pixel.
///
/// Pixels are taken `width` to a row; a last row that is not full is ignored, and a width of 0 has no
/// components.
#[must_use]
pub fn components(pixels: &[u8], width: usize, threshold: u8) -> Vec<Component> {
    connected(pixels, width, threshold, Connectivity::Eight)
}

/// The same with either connectivity.
#[must_use]
pub fn connected(
    pixels: &[u8],
    width: usize,
    threshold: u8,
    connectivity: Connectivity,
) -> Vec<Component> {
    connected_within(pixels, width, threshold, connectivity, usize::MAX).unwrap_or_default()
}

/// The same; none when more than about `most` parts of components begin. Each takes memory, also one that joins another below.
#[must_use]
pub fn connected_within(
    pixels: &[u8],
    width: usize,
    threshold: u8,
    connectivity: Connectivity,
    most: usize,
) -> Option<Vec<Component>> {
    if width == 0 {
        return Some(Vec::new());
    }
    let mut forest = Forest::new(connectivity);
    let (mut above, mut here) = (Vec::new(), Vec::new());
    for (row, line) in pixels.chunks_exact(width).enumerate() {
        here.clear();
        find_runs(line, threshold, &mut here);
        forest.connect(&above, &mut here, row);
        if forest.parts.len() > most {
            return None;
        }
        std::mem::swap(&mut above, &mut here);
    }
    let roots = forest.settle();
    let (mut parts, mut labels) = (forest.parts, roots.iter().enumerate());
    parts.retain(|_| labels.next().is_some_and(|(label, root)| label == *root));
    Some(parts)
}

/// Appends the runs of `line` that are at least `threshold`, from left to right.
fn find_runs(line: &[u8], threshold: u8, runs: &mut Vec<Run>) {
    let mut open: Option<usize> = None;
    for (index, block) in line.chunks(STRIDE).enumerate() {
        let dark = block.iter().fold(0, |most, &value| most.max(value)) < threshold;
        if dark && open.is_none() {
            continue;
        }
        // A bit for each pixel, and then for each pixel that differs from the one before it: no branch looks at a pixel.
        let bits = block.iter().enumerate();
        let bright = bits.fold(0_u64, |bits, (at, &value)| {
            bits | (u64::from(value >= threshold) << at)
        });
        let mut edges = bright ^ ((bright << 1) | u64::from(open.is_some()));
        if block.len() < STRIDE {
            edges &= (1 << block.len()) - 1;
        }
        while edges != 0 {
            let at = index * STRIDE + edges.trailing_zeros() as usize;
            edges &= edges - 1;
            match open.take() {
                Some(start) => runs.push(Run::new(line, start, at)),
                None => open = Some(at),
            }
        }
    }
    runs.extend(open.map(|start| Run::new(line, start, line.len())));
}

/// Union-find over components. A parent never has a larger label than its child, and labels are given
/// in raster order, so the root of a set is the part with the first pixel.
#[derive(Default)]
struct Forest {
    parents: Vec<usize>,
    parts: Vec<Component>,
    /// By how many columns runs may miss one another and still touch.
    corner: usize,
}

impl Forest {
    fn new(connectivity: Connectivity) -> Self {
        Self {
            corner: usize::from(connectivity == Connectivity::Eight),
            ..Self::default()
        }
    }

    fn root(&mut self, mut label: usize) -> usize {
        while self.parents[label] != label {
            self.parents[label] = self.parents[self.parents[label]];
            label = self.parents[label];
        }
        label
    }

    /// Gives each run of this row a label, joining those of the runs above that it touches.
    fn connect(&mut self, above: &[Run], here: &mut [Run], row: usize) {
        let mut next = 0;
        for run in here {
            let corner = self.corner;
            // Runs that end left of this run touch neither it nor a later one.
            let ends_before = |other: &Run| other.end + corner <= run.start;
            while above.get(next).is_some_and(ends_before) {
                next += 1;
            }
            let (mut label, mut contacts) = (None, 0);
            let touching = above.iter().skip(next);
            for other in touching.take_while(|other| other.start < run.end + corner) {
                contacts += 1;
                let root = self.root(other.label);
                label = Some(match label {
                    None => root,
                    Some(old) => self.join(old, root),
                });
            }
            run.label = match label {
                Some(root) => {
                    let part = &mut self.parts[root];
                    part.add_run(run, row);
                    // Runs have no holes, and no three touch one another, so a contact closes a way around a hole or
                    // joins two parts: the Euler number is the number of runs less the number of contacts.
                    part.euler -= contacts;
                    root
                }
                None => {
                    self.parents.push(self.parts.len());
                    self.parts.push(Component::new(run, row));
                    self.parts.len() - 1
                }
            };
        }
    }

    fn join(&mut self, a: usize, b: usize) -> usize {
        let (low, high) = (a.min(b), a.max(b));
        self.parents[high] = low;
        low
    }

    /// Adds every part to the part with the first pixel of its component, and answers the label of that for each label.
    fn settle(&mut self) -> Vec<usize> {
        for label in (0..self.parts.len()).rev() {
            let parent = self.parents[label];
            if parent != label {
                // The parent has the smaller label, so it is still to come in this order.
                let (head, tail) = self.parts.split_at_mut(label);
                if let (Some(parent), Some(part)) = (head.get_mut(parent), tail.first()) {
                    parent.absorb(part);
                }
            }
        }
        let mut roots = std::mem::take(&mut self.parents);
        for label in 0..roots.len() {
            // A parent's root is known already.
            roots[label] = roots[roots[label]];
        }
        roots
    }

    /// The components with their labels, in the order of their first pixels, and for each label that of its component.
    fn settled(mut self) -> (Vec<(usize, Component)>, Vec<usize>) {
        let roots = self.settle();
        let parts = self.parts.into_iter().enumerate();
        let components = parts.filter(|(label, _)| roots.get(*label) == Some(label));
        (components.collect(), roots)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The same by flood fill, pixel by pixel, with plain sums: slow and obviously right.
    fn by_flood_fill(
        pixels: &[u8],
        width: usize,
        threshold: u8,
        connectivity: Connectivity,
    ) -> Vec<Vec<(i64, i64)>> {
        let height = pixels.len() / width;
        let mut seen = vec![false; pixels.len()];
        let mut all = Vec::new();
        for start in 0..width * height {
            if seen[start] || pixels[start] < threshold {
                continue;
            }
            let (mut stack, mut members) = (vec![start], Vec::new());
            seen[start] = true;
            while let Some(at) = stack.pop() {
                let (u, v) = ((at % width) as i64, (at / width) as i64);
                members.push((u, v));
                for (du, dv) in (-1..=1).flat_map(|du| (-1..=1).map(move |dv| (du, dv))) {
                    if connectivity == Connectivity::Four && du != 0 && dv != 0 {
                        continue;
                    }
                    let (x, y) = (u + du, v + dv);
                    if x < 0 || y < 0 || x >= width as i64 || y >= height as i64 {
                        continue;
                    }
                    let other = y as usize * width + x as usize;
                    if !seen[other] && pixels[other] >= threshold {
                        seen[other] = true;
                        stack.push(other);
                    }
                }
            }
            all.push(members);
        }
        all
    }

    /// One minus the parts of the background that the component encloses, by flood fill around it.
    fn euler(members: &[(i64, i64)], connectivity: Connectivity) -> i64 {
        let (u0, u1) = (
            members.iter().map(|m| m.0).min(),
            members.iter().map(|m| m.0).max(),
        );
        let (v0, v1) = (
            members.iter().map(|m| m.1).min(),
            members.iter().map(|m| m.1).max(),
        );
        let (u0, v0) = (u0.unwrap() - 1, v0.unwrap() - 1);
        let width = (u1.unwrap() - u0 + 2) as usize;
        let height = (v1.unwrap() - v0 + 2) as usize;
        let mut around = vec![1; width * height];
        for (u, v) in members {
            around[(v - v0) as usize * width + (u - u0) as usize] = 0;
        }
        let other = match connectivity {
            Connectivity::Four => Connectivity::Eight,
            Connectivity::Eight => Connectivity::Four,
        };
        2 - by_flood_fill(&around, width, 1, other).len() as i64
    }

    fn check(pixels: &[u8], width: usize, threshold: u8) {
        for connectivity in [Connectivity::Four, Connectivity::Eight] {
            check_one(pixels, width, threshold, connectivity);
        }
    }

    fn check_one(pixels: &[u8], width: usize, threshold: u8, connectivity: Connectivity) {
        let found = connected(pixels, width, threshold, connectivity);
        let expected = by_flood_fill(pixels, width, threshold, connectivity);
        assert_eq!(found.len(), expected.len());
        for (component, members) in found.iter().zip(&expected) {
            let n = members.len() as f64;
            assert_eq!(component.euler, euler(members, connectivity));
            assert_eq!(component.area, members.len() as u64);
            let first = members.iter().min_by_key(|(u, v)| (*v, *u)).unwrap();
            assert_eq!(component.first, (first.0 as usize, first.1 as usize));
            let mean_u = members.iter().map(|m| m.0 as f64).sum::<f64>() / n;
            let mean_v = members.iter().map(|m| m.1 as f64).sum::<f64>() / n;
            let (u, v) = component.centroid();
            assert!((u - mean_u).abs() < 1e-9 && (v - mean_v).abs() < 1e-9);
            let mean = |f: &dyn Fn(f64, f64) -> f64| {
                let d = members
                    .iter()
                    .map(|m| f(m.0 as f64 - mean_u, m.1 as f64 - mean_v));
                d.sum::<f64>() / n
            };
            let moments = component.moments();
            assert!((moments.uu - mean(&|x, _| x * x)).abs() < 1e-9);
            assert!((moments.uv - mean(&|x, y| x * y)).abs() < 1e-9);
            assert!((moments.vv - mean(&|_, y| y * y)).abs() < 1e-9);
            let grey = |m: &(i64, i64)| pixels[m.1 as usize * width + m.0 as usize];
            let peak = members.iter().map(grey).max().unwrap();
            let peaks = members.iter().filter(|m| grey(m) == peak);
            let at = peaks.min_by_key(|(u, v)| (*v, *u)).unwrap();
            assert_eq!(component.peak, peak);
            assert_eq!(component.peak_at, (at.0 as usize, at.1 as usize));
            assert_eq!(
                component.u_min as i64,
                members.iter().map(|m| m.0).min().unwrap()
            );
            assert_eq!(
                component.u_max as i64,
                members.iter().map(|m| m.0).max().unwrap()
            );
            assert_eq!(
                component.v_min as i64,
                members.iter().map(|m| m.1).min().unwrap()
            );
            assert_eq!(
                component.v_max as i64,
                members.iter().map(|m| m.1).max().unwrap()
            );
        }
    }

    proptest! {
        #[test]
        fn runs_find_what_a_flood_fill_finds(
            width in 1_usize..80,
            pixels in prop::collection::vec(any::<u8>(), 0..3000),
            threshold in any::<u8>(),
        ) {
            let whole = pixels.len() / width * width;
            check(&pixels[..whole], width, threshold);
        }

        #[test]
        fn sparse_and_dense_pictures_agree_with_a_flood_fill_too(
            width in 1_usize..80,
            pixels in prop::collection::vec(prop::sample::select(vec![0_u8, 0, 0, 9]), 0..3000),
            inverse in any::<bool>(),
        ) {
            let whole = pixels.len() / width * width;
            let pixels: Vec<u8> = pixels.iter().map(|p| if inverse { 9 - p } else { *p }).collect();
            check(&pixels[..whole], width, 5);
        }
    }

    #[test]
    fn a_spiral_of_one_pixel_is_one_component() {
        let rows = [
            "#########",
            "........#",
            "#######.#",
            "#.....#.#",
            "#.###.#.#",
            "#.#...#.#",
            "#.#####.#",
            "#.......#",
            "#########",
        ];
        let pixels: Vec<u8> = rows.concat().bytes().map(|b| u8::from(b == b'#')).collect();
        check(&pixels, 9, 1);
        assert_eq!(components(&pixels, 9, 1).len(), 1);
    }

    #[test]
    fn corners_touch_where_eight_neighbours_count() {
        assert_eq!(connected(&[1, 0, 0, 1], 2, 1, Connectivity::Four).len(), 2);
        check(&[1, 0, 0, 1], 2, 1);
        assert_eq!(components(&[1, 0, 0, 1], 2, 1).len(), 1);
        assert_eq!(components(&[0, 1, 1, 0], 2, 1).len(), 1);
    }

    #[test]
    fn a_full_row_has_the_second_moment_of_a_uniform_comb() {
        // Mean of du² over n whole numbers is (n² - 1) / 12, exactly.
        let width = 60_000;
        let found = components(&vec![255; width], width, 1);
        let n = width as f64;
        assert_eq!(found[0].moments().uu, (n * n - 1.0) / 12.0);
        assert_eq!(found[0].moments().vv, 0.0);
    }

    /// A chequered picture has no two pixels that share a side.
    #[test]
    fn a_picture_of_too_many_parts_is_given_up_before_they_take_the_memory() {
        let pixels: Vec<u8> = (0..200 * 200)
            .map(|at| ((at % 200 + at / 200) % 2) as u8)
            .collect();
        let find = |most| connected_within(&pixels, 200, 1, Connectivity::Four, most);
        assert_eq!(find(20_000).map(|found| found.len()), Some(20_000));
        assert_eq!(find(19_000), None);
        assert_eq!(regions(&pixels, 200, 1, Connectivity::Four, 19_000), None);
    }

    #[test]
    fn empty_pictures_have_no_components() {
        assert!(components(&[], 0, 1).is_empty());
        assert!(components(&[], 7, 1).is_empty());
        assert!(components(&[9; 10], 0, 1).is_empty());
        assert_eq!(
            components(&[0; 6], 3, 0).len(),
            1,
            "a threshold of 0 takes every pixel"
        );
    }
}
