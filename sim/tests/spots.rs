//! The simulated cameras against the spot finder that will look through them: the numbers that the
//! shipped cell promises.

use ctos::diagnostic::Source;
use sim::{camera::Renderer, cell::Cell};
use vss::{
    frame::Frame,
    spot::{SpotOptions, find_spot},
};

/// Joint angles (degrees) with the tool upwards or sideways, over the arm's reach.
const POSES: [[f64; 6]; 5] = [
    [0.0, 45.0, -90.0, 0.0, 45.0, 0.0],
    [60.0, 20.0, -60.0, 0.0, 40.0, 0.0],
    [-80.0, 70.0, -130.0, 0.0, 60.0, 0.0],
    [130.0, 60.0, -100.0, 0.0, 10.0, 0.0],
    [-20.0, 100.0, -100.0, 0.0, -20.0, 0.0],
];

#[test]
fn found_spots_scatter_by_about_0_15_px_around_the_true_projection() {
    const FRAMES: u64 = 30;
    let text = include_str!("../../configs/cell.toml");
    let cell = Cell::parse(&Source::new("cell.toml", text)).unwrap();
    let mut seen = 0;
    for camera in &cell.cameras {
        let mut renderer = Renderer::new(&cell, camera, 3);
        for pose in POSES {
            let scene = cell.scene(&[&pose.map(f64::to_radians)]);
            let view = renderer.lamp_view(&scene, 0);
            let Some(view) = view.filter(|view| view.visible == 1.0) else {
                continue;
            };
            seen += 1;
            let errors: Vec<[f64; 2]> = (0..FRAMES)
                .map(|number| {
                    let frame = Frame::grey8(500, 500, renderer.render(&scene, number));
                    let spot = find_spot(&frame, &SpotOptions::default()).unwrap();
                    [spot.u - view.centre.0, spot.v - view.centre.1]
                })
                .collect();
            for axis in 0..2 {
                let n = FRAMES as f64;
                let mean = errors.iter().map(|e| e[axis]).sum::<f64>() / n;
                let sd = (errors.iter().map(|e| (e[axis] - mean).powi(2)).sum::<f64>() / (n - 1.0))
                    .sqrt();
                // The sd of a sample of 30 has a relative sd of 13 %.
                assert!((0.09..0.20).contains(&sd), "{pose:?}: sd {sd} px");
                // Edges of the arm behind the spot leave a bias, small against the scatter.
                assert!(mean.abs() < 0.12, "{pose:?}: bias {mean} px");
            }
        }
    }
    assert!(
        seen >= 8,
        "only {seen} unhidden views of {}",
        2 * POSES.len()
    );
}
