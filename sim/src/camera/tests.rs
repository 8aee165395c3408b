use ctos::diagnostic::Source;
use nalgebra::Point3;
use proptest::prelude::*;

use super::*;

fn cell() -> Cell {
    let text = include_str!("../../../configs/cell.toml");
    Cell::parse(&Source::new("cell.toml", text)).unwrap()
}

fn renderer(cell: &Cell, camera: usize) -> Renderer {
    Renderer::new(cell, &cell.cameras[camera], 1)
}

/// The scene with the lamp at `place` and the arm at rest at its start.
fn lamp_at(cell: &Cell, place: Point3<f64>) -> SceneState {
    let mut scene = cell.start();
    scene.lamps[0].centre = place;
    scene
}

fn dark(scene: &SceneState) -> SceneState {
    let mut dark = scene.clone();
    dark.lamps[0].on = false;
    dark
}

/// The lamp's own light: the picture with it less the picture without.
fn spot(renderer: &mut Renderer, scene: &SceneState) -> Vec<f64> {
    let lit = renderer.light(scene).to_vec();
    let dark = renderer.light(&dark(scene));
    lit.iter()
        .zip(dark)
        .map(|(a, b)| f64::from(*a) - f64::from(*b))
        .collect()
}

/// Centre, standard deviation per axis and peak.
fn moments(picture: &[f64], width: usize) -> ((f64, f64), (f64, f64), f64) {
    let total: f64 = picture.iter().sum();
    let mean = |f: &dyn Fn(f64, f64) -> f64| {
        let sum: f64 = picture
            .iter()
            .enumerate()
            .map(|(i, w)| w * f((i % width) as f64, (i / width) as f64))
            .sum();
        sum / total
    };
    let (u, v) = (mean(&|u, _| u), mean(&|_, v| v));
    let sd = (
        mean(&|x, _| (x - u).powi(2)).sqrt(),
        mean(&|_, y| (y - v).powi(2)).sqrt(),
    );
    (
        (u, v),
        sd,
        picture.iter().copied().fold(f64::NEG_INFINITY, f64::max),
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    #[test]
    fn the_centre_of_the_noise_free_spot_is_the_projected_centre_of_the_lamp(
        x in -0.8..0.8_f64, y in -0.8..0.8_f64, z in 0.4..1.5_f64, camera in 0..2_usize,
    ) {
        let cell = cell();
        let mut renderer = renderer(&cell, camera);
        let scene = lamp_at(&cell, Point3::new(x, y, z));
        let view = renderer.lamp_view(&scene, 0);
        prop_assume!(view.is_some_and(|view| view.visible == 1.0));
        let (u, v) = renderer.truth().project(&scene.lamps[0].centre).unwrap();
        prop_assume!(u > 15.0 && v > 15.0 && u < 484.0 && v < 484.0);
        let ((su, sv), ..) = moments(&spot(&mut renderer, &scene), 500);
        prop_assert!((su - u).hypot(sv - v) < 0.02, "{su} {sv} against {u} {v}");
    }
}

#[test]
fn spots_are_as_wide_and_as_bright_as_centroids_of_0_15_px_need() {
    let cell = cell();
    for camera in 0..2 {
        let mut renderer = renderer(&cell, camera);
        let mut bounds = Vec::new();
        for place in [
            [0.6, 0.2, 0.5],
            [-0.4, -0.5, 1.0],
            [0.2, 0.5, 1.4],
            [-0.2, 0.6, 0.9],
        ] {
            let scene = lamp_at(&cell, place.into());
            assert_eq!(renderer.lamp_view(&scene, 0).unwrap().visible, 1.0);
            let (_, sd, peak) = moments(&spot(&mut renderer, &scene), 500);
            for sd in [sd.0, sd.1] {
                assert!((1.4..2.6).contains(&sd), "{place:?}: sd {sd} px");
            }
            // Cramer-Rao for a Gaussian spot: sqrt(2/pi) * noise / amplitude per coordinate, px.
            let bound = std::f64::consts::FRAC_2_PI.sqrt() * cell.cameras[camera].read_noise / peak;
            bounds.push(bound);
        }
        let mean = bounds.iter().sum::<f64>() / bounds.len() as f64;
        assert!((0.12..0.18).contains(&mean), "{bounds:?} px");
    }
}

#[test]
fn every_place_of_the_work_volume_is_inside_both_pictures() {
    let cell = cell();
    for camera in &cell.cameras {
        for z in [0.4_f64, 0.9, 1.3] {
            for turn in 0..16 {
                let angle = f64::from(turn) * std::f64::consts::TAU / 16.0;
                // What a lamp 0.15 m before the wrist of an arm of 0.86 m reach can come to.
                let reach = (1.0_f64 - (z - 0.67_f64).powi(2)).sqrt() * 0.85;
                let place = Point3::new(reach * angle.cos(), reach * angle.sin(), z);
                let (u, v) = camera.truth.project(&place).unwrap();
                assert!(
                    (5.0..495.0).contains(&u) && (5.0..495.0).contains(&v),
                    "{} {place}: {u} {v}",
                    camera.truth.name
                );
            }
        }
    }
}

#[test]
fn the_arm_hides_a_lamp_below_it() {
    let cell = cell();
    let mut renderer = renderer(&cell, 0);
    let mut scene = cell.start();
    // Straight behind the elbow housing, seen from the camera.
    let eye = renderer.truth().position();
    let elbow = scene.body("puma.link2").unwrap().pose * Point3::new(-0.2, 0.0, 0.235);
    scene.lamps[0].centre = elbow + (elbow - eye).normalize() * 0.2;
    assert_eq!(renderer.lamp_view(&scene, 0).unwrap().visible, 0.0);
    assert!(spot(&mut renderer, &scene).iter().all(|x| x.abs() < 1e-3));
    scene.lamps[0].centre = elbow - (elbow - eye).normalize() * 0.2;
    assert_eq!(renderer.lamp_view(&scene, 0).unwrap().visible, 1.0);
}

#[test]
fn a_lamp_that_is_off_or_outside_leaves_no_light() {
    let cell = cell();
    let mut renderer = renderer(&cell, 0);
    let off = dark(&cell.start());
    let unlit = renderer.light(&off).to_vec();
    let outside = lamp_at(&cell, Point3::new(30.0, 0.0, 0.5));
    assert_eq!(renderer.lamp_view(&outside, 0), None);
    assert_eq!(renderer.light(&outside), unlit);
    let behind = lamp_at(&cell, Point3::new(0.0, 0.0, 4.0));
    assert_eq!(renderer.light(&behind), unlit);
    assert!(unlit.iter().all(|grey| (0.0..90.0).contains(grey)));
}

#[test]
fn a_picture_shows_at_every_pixel_the_nearest_solid_of_the_scene() {
    let objects = "
        [[object]]
        name = 'can'
        shape = 'cylinder'
        radius = 0.06
        height = 0.2
        mass = 0.5
        grey = 120
        position = [0.6, 0.4, 0.9]
        rpy = [30.0, 40.0, 0.0]
        [[object]]
        name = 'cube'
        shape = 'box'
        size = [0.1, 0.2, 0.3]
        mass = 0.5
        grey = 200
        position = [-0.6, 0.4, 0.5]
        rpy = [0.0, 0.0, 20.0]
    ";
    let text = include_str!("../../../configs/cell.toml").to_owned() + objects;
    let cell = Cell::parse(&Source::new("cell.toml", text)).unwrap();
    let mut renderer = renderer(&cell, 1);
    let joints = [0.7, 0.4, -0.9, 0.3, 0.6, 0.1];
    let scene = dark(&cell.scene(&[&joints]));
    let picture = renderer.light(&scene).to_vec();
    // The slow way: every solid for every (sampled) pixel, no windows, no depth buffer.
    let solids: Vec<_> = renderer.still.iter().chain(&renderer.moving).collect();
    let mut of_the_arm = 0;
    for (index, ray) in renderer.rays.iter().enumerate().step_by(7) {
        let pose = renderer.camera.camera_t_world;
        let floor = raster::floor(&pose, ray, cell.floor_grey);
        let nearest = solids
            .iter()
            .filter_map(|solid| Some((solid.hit(ray)?, solid.shade(ray, solid.hit(ray)?))))
            .chain(floor)
            .min_by(|a, b| a.0.total_cmp(&b.0));
        let expected = nearest.map_or(cell.floor_grey / 2.0, |(_, grey)| grey);
        assert!((f64::from(picture[index]) - expected).abs() < 1e-3);
        of_the_arm += usize::from(floor.is_some_and(|floor| Some(floor) != nearest));
    }
    assert!(of_the_arm > 500, "{of_the_arm}");
}

#[test]
fn the_same_seed_and_number_give_the_same_picture() {
    let cell = cell();
    let scene = cell.start();
    let first = renderer(&cell, 0).render(&scene, 5);
    let mut again = renderer(&cell, 0);
    let other = again.render(&scene, 4);
    assert_eq!(first, again.render(&scene, 5));
    assert_ne!(first, other);
    assert_ne!(first, renderer(&cell, 1).render(&scene, 5));
}

#[test]
fn a_camera_on_a_link_sees_what_a_fixed_one_sees_from_there() {
    let text = include_str!("../../../configs/cell.toml").replace(
        "name = \"ceiling_west\"",
        "name = \"wrist\"\narm = \"puma\"\nlink = \"link4\"",
    );
    let text = text
        .replace(
            "position = [-0.52, 0.06, 2.91]",
            "position = [0.0, 0.1, 0.0]",
        )
        .replace("look_at = [0.05, -0.02, 0.8]", "look_at = [0.0, 1.0, 0.2]")
        .replace("up = [0.0, 1.0, 0.0]", "up = [0.0, 0.0, 1.0]");
    let cell = Cell::parse(&Source::new("cell.toml", text)).unwrap();
    let carried = cell.camera("wrist").unwrap();
    let mut renderer = Renderer::new(&cell, carried, 1);
    let mut before = Vec::new();
    for joints in [
        [0.7, 0.4, -0.9, 0.3, 0.6, 0.1],
        [-1.5, 1.0, -1.6, 0.1, 0.2, 0.0],
    ] {
        let scene = cell.scene(&[&joints]);
        let mut fixed = carried.clone();
        (fixed.truth, fixed.mount) = (carried.at(&scene), None);
        let seen = renderer.light(&scene).to_vec();
        assert_eq!(seen, Renderer::new(&cell, &fixed, 1).light(&scene));
        assert_ne!(seen, before);
        before = seen;
    }
}
