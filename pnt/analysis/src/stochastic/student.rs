//! Quantiles of Student's distribution, for confidence intervals of means.

/// The probability that |t| is at most `t`, with `freedom` degrees of freedom (Abramowitz and Stegun,
/// 26.7.3 and 26.7.4).
fn within(t: f64, freedom: u32) -> f64 {
    let theta = (t / f64::from(freedom).sqrt()).atan();
    let (sin, cos) = theta.sin_cos();
    let (mut term, mut sum, first) = if freedom % 2 == 1 {
        (cos, if freedom == 1 { 0.0 } else { cos }, 3)
    } else {
        (1.0, 1.0, 2)
    };
    for k in (first..freedom.saturating_sub(1)).step_by(2) {
        term *= cos * cos * f64::from(k - 1) / f64::from(k);
        sum += term;
    }
    if freedom % 2 == 1 {
        std::f64::consts::FRAC_2_PI * (theta + sin * sum)
    } else {
        sin * sum
    }
}

/// The t within which a value lies with probability `confidence`, by halving.
pub(super) fn quantile(confidence: f64, freedom: u32) -> f64 {
    let (mut low, mut high) = (0.0_f64, 1e6_f64);
    for _ in 0..200 {
        let middle = low.midpoint(high);
        if within(middle, freedom) < confidence {
            low = middle;
        } else {
            high = middle;
        }
    }
    high
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_gives_the_values_of_the_printed_tables() {
        for (confidence, freedom, printed) in [
            (0.95, 1, 12.706),
            (0.95, 2, 4.303),
            (0.95, 3, 3.182),
            (0.95, 29, 2.045),
            (0.99, 29, 2.756),
            (0.90, 30, 1.697),
            (0.95, 120, 1.980),
        ] {
            let ours = quantile(confidence, freedom);
            assert!(
                (ours - printed).abs() < 6e-4,
                "{confidence} {freedom}: {ours}"
            );
        }
    }
}
