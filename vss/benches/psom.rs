//! Completion by a map of 3 x 3 x 3 nodes: the place of a ball from its blob, once inside the examples and once far outside.

use divan::{Bencher, black_box};
use nalgebra::Point3;
use vss::target_map::{Seen, TargetMap};

fn main() {
    divan::main();
}

fn seen(place: &Point3<f64>) -> Seen {
    let radius = 800.0 * 0.03 / place.z;
    Seen {
        u: 320.0 + 800.0 * place.x / place.z,
        v: 240.0 + 800.0 * place.y / place.z,
        radius,
        spread: radius,
    }
}

fn trained() -> Option<TargetMap> {
    let examples = std::array::from_fn(|index| {
        let node = |index: usize| index as f64 - 1.0;
        let place = Point3::new(
            0.15 * node(index / 9),
            0.1 * node(index / 3 % 3),
            1.0 + 0.1 * node(index % 3),
        );
        (place, seen(&place))
    });
    let sd = Seen {
        u: 0.03,
        v: 0.03,
        radius: 0.03,
        spread: 0.03,
    };
    TargetMap::train(&examples, &sd, 10.0).ok()
}

#[divan::bench(args = [0.07, 0.7])]
fn locate(bencher: Bencher, x: f64) {
    let Some(mut map) = trained() else { return };
    let ball = seen(&Point3::new(x, -0.03, 1.04));
    bencher.bench_local(|| map.locate(black_box(&ball)).map(|found| found.error));
}
