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

/// Lights on a dim floor, far from everything else.
#[test]
fn spots_of_a_picture_without_noise_come_back_within_a_fiftieth_of_a_pixel() {
    let text = include_str!("../../configs/cell.toml");
    let mut cell = Cell::parse(&Source::new("cell.toml", text)).unwrap();
    let mut found = 0;
    for index in 0..cell.cameras.len() {
        (
            cell.cameras[index].read_noise,
            cell.cameras[index].shot_noise,
        ) = (0.0, 0.0);
        let mut renderer = Renderer::new(&cell, &cell.cameras[index], 1);
        for step in 0..40 {
            let mut scene = cell.start();
            let angle = f64::from(step) * 0.7;
            let reach = 0.5 + 0.01 * f64::from(step);
            let place = [
                reach * angle.cos(),
                reach * angle.sin(),
                0.4 + 0.02 * f64::from(step),
            ];
            scene.lamps[0].centre = place.into();
            let Some(view) = renderer
                .lamp_view(&scene, 0)
                .filter(|view| view.visible == 1.0)
            else {
                continue;
            };
            // Without the arm and the benches behind it: what stands there pulls at any centroid.
            let plain = !scene.bodies.iter().any(|body| {
                let at = renderer
                    .truth()
                    .project(&body.pose.translation.vector.into());
                at.is_some_and(|(u, v)| (u - view.centre.0).hypot(v - view.centre.1) < 120.0)
            });
            if !plain {
                continue;
            }
            let frame = Frame::grey8(500, 500, renderer.render(&scene, 0));
            let spot = find_spot(&frame, &SpotOptions::default()).unwrap();
            let off = (spot.u - view.centre.0).hypot(spot.v - view.centre.1);
            assert!(off < 0.02, "{place:?}: {off} px");
            found += 1;
        }
    }
    assert!(found > 10, "{found}");
}
