use ctos_config::diagnostic::Source;
use nalgebra::Point3;
use proptest::prelude::*;

use super::*;

fn cell() -> Cell {
    let text = include_str!("../../../../configs/cell.toml");
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

/// The disc of a lamp that is `distance` m in front of the first camera, off its axis, and the radius of its picture, px.
fn near_lamp(cell: &Cell, renderer: &Renderer, distance: f64) -> (SceneState, f64) {
    let there = renderer.truth().camera_t_world.inverse();
    let scene = lamp_at(
        cell,
        there * Point3::new(0.05 * distance, -0.03 * distance, distance),
    );
    let radius = cell.lamps[0].radius * renderer.truth().focal[0] / distance;
    (scene, radius)
}

#[test]
fn a_lamp_near_a_camera_is_an_even_round_disc_with_its_centre_where_that_projects() {
    let cell = cell();
    let mut renderer = renderer(&cell, 0);
    for distance in [0.06, 0.1, 0.2, 0.4, 0.7, 1.2] {
        let (scene, radius) = near_lamp(&cell, &renderer, distance);
        let light = spot(&mut renderer, &scene);
        let (u, v) = renderer.truth().project(&scene.lamps[0].centre).unwrap();
        let ((su, sv), sd, _) = moments(&light, 500);
        assert!(
            (su - u).hypot(sv - v) < 0.02,
            "{distance}: {su} {sv} against {u} {v}"
        );
        // A disc has a quarter of the square of its radius along each axis.
        let blur = cell.cameras[0].blur;
        for sd in [sd.0, sd.1] {
            let expected = (0.25 * radius * radius + blur * blur).sqrt();
            assert!(
                (sd / expected - 1.0).abs() < 0.03,
                "{distance}: {sd} {expected}"
            );
        }
        let brightness = cell.lamps[0].brightness;
        let inside = light.iter().enumerate().filter(|(at, _)| {
            let far = ((at % 500) as f64 - u).hypot((at / 500) as f64 - v);
            far < 0.95 * radius - 4.0 * blur
        });
        for (at, grey) in inside {
            assert!(
                (grey / brightness - 1.0).abs() < 1e-3,
                "{distance}: {grey} at {at}"
            );
        }
        let sum: f64 = light.iter().sum();
        // The lens makes a large disc a little smaller.
        let area = std::f64::consts::PI * radius * radius;
        assert!(
            (sum / brightness / area - 1.0).abs() < 0.03,
            "{distance}: {sum}"
        );
    }
}

/// What is found in the pictures of lamps at any distance is where they are.
#[test]
fn spots_of_near_and_far_lamps_come_back_within_two_hundredths_of_a_pixel() {
    let mut cell = cell();
    cell.lamps[0].brightness = 180.0;
    for camera in &mut cell.cameras {
        (camera.read_noise, camera.shot_noise) = (0.0, 0.0);
    }
    cell.room.clear();
    cell.bodies.clear();
    let mut renderer = renderer(&cell, 0);
    for (number, distance) in (0..).zip([0.1, 0.15, 0.22, 0.33, 0.5, 0.75, 1.1, 1.7]) {
        let (scene, _) = near_lamp(&cell, &renderer, distance);
        let pixels = renderer.render(&scene, number);
        let frame = vss_tools::frame::Frame::grey8(500, 500, pixels);
        let found =
            vss_tools::spot::find_spots(&frame, &vss_tools::spot::SpotsOptions::default()).unwrap();
        let (u, v) = renderer.truth().project(&scene.lamps[0].centre).unwrap();
        let [spot] = found.spots[..] else {
            panic!("{distance}: {found:?}");
        };
        let off = (spot.u - u).hypot(spot.v - v);
        assert!(off < 0.02, "{distance}: {off} {spot:?}");
        assert!(!spot.flags.elongated, "{distance}: {spot:?}");
    }
}

/// A lamp that fills the picture costs what its pixels cost, and one behind the camera nothing.
#[test]
fn a_lamp_before_the_lens_fills_the_picture_evenly() {
    let cell = cell();
    let mut renderer = renderer(&cell, 0);
    let there = renderer.truth().camera_t_world.inverse();
    let scene = lamp_at(&cell, there * Point3::new(0.0, 0.0, 0.004));
    let brightness = cell.lamps[0].brightness;
    let light = spot(&mut renderer, &scene);
    let off = light.iter().map(|grey| (grey / brightness - 1.0).abs());
    assert!(off.fold(0.0, f64::max) < 2e-3);
    let behind = lamp_at(&cell, there * Point3::new(0.0, 0.0, -0.1));
    assert!(spot(&mut renderer, &behind).iter().all(|grey| *grey == 0.0));
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
    let text = include_str!("../../../../configs/cell.toml").to_owned() + objects;
    let cell = Cell::parse(&Source::new("cell.toml", text)).unwrap();
    let mut renderer = renderer(&cell, 1);
    let joints = [0.7, 0.4, -0.9, 0.3, 0.6, 0.1];
    let scene = dark(&cell.scene(&[&joints]));
    let picture = renderer.light(&scene).to_vec();
    // The slow way: every solid for every (sampled) pixel, no windows, no depth buffer.
    let floor = Floor::new(&renderer.camera.camera_t_world);
    let grey = cell.floor_grey as f32;
    let solids = &renderer.solids;
    let (mut of_the_arm, mut edges) = (0, 0);
    for row in 1..499 {
        for column in (1 + row % 7..499).step_by(7) {
            let (here, expected) = nearest(
                solids,
                &floor,
                grey,
                &renderer.rays.all()[row * 500 + column],
            );
            let mut inside = true;
            for at in [-501_isize, -500, -499, -1, 1, 499, 500, 501] {
                let at = (row * 500 + column).checked_add_signed(at).unwrap();
                inside &= nearest(solids, &floor, grey, &renderer.rays.all()[at]).0 == here;
            }
            of_the_arm += usize::from(here.is_some());
            if inside {
                let seen = picture[row * 500 + column];
                assert!(
                    (seen - expected).abs() < 2e-3,
                    "{row} {column}: {seen} {expected}"
                );
            } else {
                edges += 1;
            }
        }
    }
    assert!(of_the_arm > 500 && edges > 50, "{of_the_arm} {edges}");
}

/// What a ray meets first, a solid by index or nothing but floor and sky, and its grey.
fn nearest(
    solids: &[Seen],
    floor: &Floor,
    floor_grey: f32,
    ray: &Vector3<f64>,
) -> (Option<usize>, f32) {
    let mut best = match floor.hit(ray) {
        Some(distance) => (
            distance,
            None,
            floor_grey * floor.shade(ray, distance) as f32,
        ),
        None => (f64::INFINITY, None, floor_grey / 2.0),
    };
    for (index, solid) in solids.iter().enumerate() {
        if let Some(distance) = solid.hit(ray)
            && distance < best.0
        {
            let grey = solid.tone[0] * solid.shade(ray, distance) as f32;
            best = (distance, Some(index), grey);
        }
    }
    (best.1, best.2)
}

/// One shape of each kind that can lie on the floor, bright on a black floor, under a camera that looks straight down.
fn on_the_floor(shape: &str, place: [f64; 2]) -> Cell {
    let [x, y] = place;
    let text = format!(
        "
        [room]
        floor_grey = 0.0
        [[camera]]
        name = 'above'
        width = 64
        height = 64
        fx = 200.0
        fy = 200.0
        cx = 31.5
        cy = 31.5
        k1 = -0.1
        k2 = 0.02
        p1 = 5e-4
        p2 = -4e-4
        k3 = 0.0
        position = [0.02, 0.01, 1.0]
        look_at = [0.0, 0.0, 0.0]
        up = [0.0, 1.0, 0.0]
        blur = 1.0
        read_noise = 0.0
        shot_noise = 0.0
        {shape}
        "
    );
    let text = text.replace("PLACE", &format!("{x:?}, {y:?}"));
    Cell::parse(&Source::new("cell.toml", text)).unwrap()
}

/// Centroid of the light.
fn centroid(light: &[f64], width: usize) -> (f64, f64) {
    let (centre, ..) = moments(light, width);
    centre
}

#[test]
fn edges_lie_between_pixels_so_that_centroids_do() {
    let thing = "mass = 1.0\ngrey = 200\n";
    let shapes = [
        format!(
            "[[object]]\nname = 'a'\nshape = 'sphere'\nradius = 0.05\nposition = [PLACE, 0.05]\n{thing}"
        ),
        format!(
            "[[object]]\nname = 'a'\nshape = 'cylinder'\nradius = 0.04\nheight = 0.02\nposition = [PLACE, 0.01]\n{thing}"
        ),
        format!(
            "[[object]]\nname = 'a'\nshape = 'box'\nsize = [0.08, 0.06, 0.02]\nposition = [PLACE, 0.01]\nrpy = [0.0, 0.0, 20.0]\n{thing}"
        ),
        "[[mark]]\ncentre = [PLACE, 0.0]\nnormal = [0.0, 0.0, 1.0]\nradius = 0.05\ngrey = 200\n"
            .to_owned(),
    ];
    for shape in &shapes {
        for step in 0..5 {
            // By thirds of a pixel or so.
            let off = f64::from(step) * 0.0017;
            let cell = on_the_floor(shape, [0.011 + off, -0.007 - 0.6 * off]);
            let mut renderer = renderer(&cell, 0);
            let seen: Vec<f64> = renderer
                .light(&cell.start())
                .iter()
                .map(|x| f64::from(*x))
                .collect();
            // Each pixel by 16 x 16 rays through its square.
            let floor = Floor::new(&renderer.camera.camera_t_world);
            let mut exact = Vec::new();
            for pixel in 0..64 * 64 {
                let (u, v) = ((pixel % 64) as f64, (pixel / 64) as f64);
                let part = |k: usize| (k as f64 + 0.5) / 16.0 - 0.5;
                let rays = (0..256).map(|k| {
                    let ray = renderer
                        .camera
                        .direction(u + part(k % 16), v + part(k / 16));
                    ray.unwrap().normalize()
                });
                let greys = rays.map(|ray| nearest(&renderer.solids, &floor, 0.0, &ray).1);
                exact.push(greys.map(f64::from).sum::<f64>() / 256.0);
            }
            let (u, v) = centroid(&seen, 64);
            let (eu, ev) = centroid(&exact, 64);
            assert!(
                (u - eu).hypot(v - ev) < 0.02,
                "{u} {v} against {eu} {ev} of {shape}"
            );
            let (area, true_area): (f64, f64) = (seen.iter().sum(), exact.iter().sum());
            assert!(
                (area / true_area - 1.0).abs() < 0.01,
                "{area} {true_area} of {shape}"
            );
            // The same without a look at edges would be off by more.
            let hard = (0..64 * 64).map(|k| {
                f64::from(nearest(&renderer.solids, &floor, 0.0, &renderer.rays.all()[k]).1)
            });
            let hard: Vec<f64> = hard.collect();
            let off = |light: &[f64]| {
                let pairs = light.iter().zip(&exact);
                pairs.map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
            };
            assert!(
                off(&seen) < 0.5 * off(&hard),
                "{} {}",
                off(&seen),
                off(&hard)
            );
        }
    }
}

#[test]
fn a_colour_camera_sees_colours_that_a_grey_one_sees_by_bt_709() {
    let shape = "[[mark]]\ncentre = [PLACE, 0.0]\nnormal = [0.0, 0.0, 1.0]\nradius = 0.05\ncolour = [200.0, 100.0, 50.0]\n";
    let mut cell = on_the_floor(shape, [0.02, 0.01]);
    let scene = cell.start();
    let grey = renderer(&cell, 0).light(&scene).to_vec();
    cell.cameras[0].colour = true;
    let mut renderer = renderer(&cell, 0);
    assert_eq!(renderer.format(), PixelFormat::Rgb8);
    let rgb = renderer.light(&scene).to_vec();
    assert_eq!(rgb.len(), 3 * grey.len());
    for (rgb, grey) in rgb.chunks(3).zip(&grey) {
        let luma = 0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2];
        assert!((luma - grey).abs() < 1e-3);
        assert!((rgb[0] - 2.0 * rgb[1]).abs() < 1e-3 && (rgb[1] - 2.0 * rgb[2]).abs() < 1e-3);
    }
    let frame = renderer.render(&scene, 1);
    let frame = vss_tools::frame::Frame::rgb8(64, 64, frame);
    assert!(frame.is_whole());
    let [red, green, blue] = frame.rgb(31, 31).unwrap().map(i32::from);
    assert!(red > 150 && (red - 2 * green).abs() <= 3 && (green - 2 * blue).abs() <= 3);
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
    let text = include_str!("../../../../configs/cell.toml").replace(
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
