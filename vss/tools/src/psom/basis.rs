//! Lagrange polynomials over the nodes of an axis, and sums of vectors weighted by them.

/// The Lagrange polynomials of `nodes` at `s` and their slopes there, in the form without division by `s - node`: a
/// search begins at a node.
pub(super) fn lagrange(nodes: &[f64], s: f64, values: &mut [f64], slopes: &mut [f64]) {
    let pairs = values.iter_mut().zip(slopes).enumerate();
    for ((i, (value, slope)), at) in pairs.zip(nodes) {
        // The product rule, factor by factor: (f g)' = f' g + f g'.
        (*value, *slope) = (1.0, 0.0);
        for (j, other) in nodes.iter().enumerate() {
            if i != j {
                let scale = 1.0 / (at - other);
                let factor = (s - other) * scale;
                *slope = *slope * factor + *value * scale;
                *value *= factor;
            }
        }
    }
}

/// Sums over an axis: `from` is outer x factors x d, `to` becomes outer x d.
pub(super) fn contract(from: &[f64], to: &mut [f64], factors: &[f64], outer: usize, d: usize) {
    let blocks = from.chunks_exact(factors.len() * d).take(outer);
    for (block, sums) in blocks.zip(to.chunks_exact_mut(d)) {
        sums.fill(0.0);
        for (row, factor) in block.chunks_exact(d).zip(factors) {
            for (sum, value) in sums.iter_mut().zip(row) {
                *sum += factor * value;
            }
        }
    }
}

/// The same within one tensor: a sum is written where nothing that is still to be read stands.
pub(super) fn contract_in_place(tensor: &mut [f64], factors: &[f64], outer: usize, d: usize) {
    let n = factors.len();
    for block in 0..outer {
        for component in 0..d {
            let rows = (0..n).map(|row| (block * n + row) * d + component);
            let sum: f64 = rows.zip(factors).map(|(at, f)| f * tensor[at]).sum();
            tensor[block * d + component] = sum;
        }
    }
}
