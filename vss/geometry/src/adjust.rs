//! Least squares on normal equations, with a step that each problem applies in its own way (rotations by turning).

use nalgebra::{DMatrix, DVector};

/// Steps after which a fit that still changes is taken as it is.
const MOST_STEPS: usize = 100;
/// A relative fall of the sum of squares below which a fit is at its end.
const STILL: f64 = 1e-12;

/// A problem of least squares at one place.
pub trait Adjustable: Sized {
    /// Sum of squared residuals; `None` where there are none.
    fn squares(&self) -> Option<f64>;

    /// JᵀJ and -Jᵀr with the derivatives J of the residuals r; `None` where there are none.
    fn equations(&self) -> Option<(DMatrix<f64>, DVector<f64>)>;

    /// The problem a step away.
    fn moved(&self, step: &DVector<f64>) -> Self;
}

/// The place of least squares, by Levenberg's and Marquardt's method; `None` where it breaks down.
pub fn adjusted<P: Adjustable>(problem: P) -> Option<P> {
    adjusted_until(problem, STILL)
}

/// The same; it ends when a step lowers the sum of squares by less than the part `still`.
pub fn adjusted_until<P: Adjustable>(mut problem: P, still: f64) -> Option<P> {
    let mut squares = problem.squares().filter(|squares| squares.is_finite())?;
    let mut damping = 1e-3;
    for _ in 0..MOST_STEPS {
        let (normal, right) = problem.equations()?;
        let (next, next_squares) = loop {
            let mut damped = normal.clone();
            for k in 0..damped.nrows() {
                damped[(k, k)] += damping * normal[(k, k)] + f64::MIN_POSITIVE;
            }
            let step = damped.cholesky().map(|factor| factor.solve(&right));
            let next = step.map(|step| problem.moved(&step));
            let found = next.and_then(|next| Some((next.squares()?, next)));
            match found {
                Some((next_squares, next)) if next_squares <= squares => {
                    break (next, next_squares);
                }
                // So small a step changes nothing any more.
                _ if damping > 1e12 => return Some(problem),
                _ => damping *= 10.0,
            }
        };
        damping = (0.1 * damping).max(1e-12);
        let fall = squares - next_squares;
        (problem, squares) = (next, next_squares);
        if fall <= still * squares {
            break;
        }
    }
    Some(problem)
}

/// [`Adjustable::equations`] with derivatives by central differences: `residuals` takes a step of one of the `unknown`
/// parameters and gives the residuals there.
pub fn by_differences(
    unknown: usize,
    residuals: impl Fn(&DVector<f64>) -> Option<DVector<f64>>,
) -> Option<(DMatrix<f64>, DVector<f64>)> {
    const STEP: f64 = 1e-6;
    let here = residuals(&DVector::zeros(unknown))?;
    let mut jacobian = DMatrix::zeros(here.len(), unknown);
    for column in 0..unknown {
        let mut by = DVector::zeros(unknown);
        by[column] = STEP;
        let slope = (residuals(&by)? - residuals(&-by)?) / (2.0 * STEP);
        jacobian.set_column(column, &slope);
    }
    Some((jacobian.tr_mul(&jacobian), -jacobian.tr_mul(&here)))
}

/// The inverse of a normal matrix, and its condition number with columns scaled; `None` if it has none.
pub fn inverse(normal: &DMatrix<f64>) -> Option<(DMatrix<f64>, f64)> {
    let free = normal.nrows();
    let scale = normal.diagonal().map(|entry| 1.0 / entry.sqrt());
    let scaled = DMatrix::from_fn(free, free, |i, j| normal[(i, j)] * scale[i] * scale[j]);
    if !scaled.iter().all(|entry| entry.is_finite()) {
        return None;
    }
    // Each value takes some rounds.
    let rounds = 1000 + 30 * free;
    let values = scaled.clone().try_symmetric_eigen(1e-15, rounds)?;
    let values = values.eigenvalues;
    let condition = (values.max() / values.min().max(0.0)).sqrt();
    let inverse = scaled.cholesky()?.inverse();
    let unscaled = DMatrix::from_fn(free, free, |i, j| inverse[(i, j)] * scale[i] * scale[j]);
    Some((unscaled, condition))
}
