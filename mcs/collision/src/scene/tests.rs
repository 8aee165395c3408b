use mcs::model::{built_in, file::Inertias};
use nalgebra::Vector3;

use super::*;

fn model(name: &str) -> Arc<Model> {
    Arc::new(built_in::model(name, Inertias::Engine).unwrap().unwrap())
}

fn alone(name: &str, room: Vec<(String, Solid)>) -> Scene {
    Scene::new([(model(name), Placement::identity())], room, 0.02)
}

fn at_rest(position: &[f64]) -> Shown {
    let position = Joints::try_from(position).unwrap();
    Shown {
        ticks: 1,
        velocity: Joints::zeros(position.len()),
        stopping: Stopping::standing(&position),
        position,
    }
}

/// The way of joints that brake evenly to rest, in a time (s), from their speeds.
fn braking(position: &Joints, speed: &Joints, time: f64) -> Stopping {
    Stopping {
        time,
        way: mcs::trajectory::way_to_rest(1.0, |share| {
            let seconds = 0.0045 + 0.5 * time * share * (2.0 - share);
            Joints::from_fn(position.len(), |index| {
                position[index] + speed[index] * seconds
            })
        }),
    }
}

#[test]
fn links_that_follow_one_another_and_those_that_always_touch_are_no_pair() {
    let scene = alone("puma560", Vec::new());
    let names = scene.names();
    let has = |one: &str, other: &str| {
        let pair = [one.to_owned(), other.to_owned()];
        names.contains(&pair) || names.contains(&[pair[1].clone(), pair[0].clone()])
    };
    for (one, other) in [
        ("base", "link2"),
        ("base", "link3"),
        ("base", "link6"),
        ("link1", "link4"),
        ("link2", "link6"),
    ] {
        assert!(has(one, other), "{one} {other} {names:?}");
    }
    // Neighbours; and at the wrist's centre three links meet.
    for (one, other) in [
        ("base", "link1"),
        ("link1", "link2"),
        ("link2", "link3"),
        ("link3", "link4"),
        ("link4", "link6"),
    ] {
        assert!(!has(one, other), "{one} {other}");
    }
    let both = alone("testbed18", Vec::new()).names();
    assert!(
        both.iter()
            .any(|[one, other]| one == "left_arm.link6" && other == "right_arm.link6")
    );
}

/// A ball that stands still before an arm that turns about its first joint.
fn before_a_ball(speed: f64, angle: f64) -> Looked {
    let ball = Solid::sphere(
        Vector3::new(0.8 * angle.cos(), 0.8 * angle.sin(), 0.67),
        0.05,
    );
    let mut scene = alone("puma560", vec![("ball".to_owned(), ball)]);
    // Stretched out, at the height of the ball.
    let mut shown = at_rest(&[0.0, 0.0, -std::f64::consts::FRAC_PI_2, 0.0, 0.0, 0.0]);
    shown.velocity[0] = speed;
    shown.stopping = braking(&shown.position, &shown.velocity, 0.2);
    scene.see(0, &shown, 0.0045, 0.0045);
    scene.look()
}

#[test]
fn a_ball_that_would_be_met_before_rest_is_found_and_one_behind_or_farther_away_is_not() {
    assert!(before_a_ball(0.0, 0.1).touches.is_none());
    // It would come to rest 0.2 rad from here; the ball is 0.13 m away.
    let near = before_a_ball(1.9, 0.1).touches.unwrap();
    assert!(near.now > 0.1 && near.least <= 0.02, "{near:?}");
    assert!(before_a_ball(-1.9, 0.1).touches.is_none());
    assert!(before_a_ball(1.9, 0.3).touches.is_none());
    assert!(before_a_ball(0.5, 0.1).touches.is_none());
}

#[test]
fn what_is_nearer_than_the_margin_may_move_away_and_no_nearer() {
    let angles = (0..400).map(|step| 0.2 - 0.001 * f64::from(step));
    let near = |angle: &f64| before_a_ball(0.0, *angle).nearest.unwrap().now < 0.01;
    let angle = angles.into_iter().find(near).unwrap();
    assert!(before_a_ball(0.0, angle).touches.is_none());
    assert!(before_a_ball(-0.3, angle).touches.is_none());
    assert!(before_a_ball(0.001, angle).touches.is_some());
}

#[test]
fn no_solid_moves_more_than_its_levers_say() {
    let model = model("testbed9");
    let mut arm = Arm::new(Arc::clone(&model), Placement::shifted(0.3, -0.2, 0.1));
    for sample in 0..200 {
        let q = spread(&model, sample);
        let to = spread(&model, sample + 1000);
        let by = Joints::from_fn(9, |joint| (to[joint] - q[joint]) * 0.1);
        let end = Joints::from_fn(9, |joint| q[joint] + by[joint]);
        arm.goes(Way::straight(&q, &end));
        arm.way.until(1.0);
        let (first, last) = (arm.at(0).to_vec(), arm.at(PIECES).to_vec());
        for (part, (first, last)) in arm.parts.iter().zip(first.iter().zip(&last)) {
            let most: f64 = part
                .levers
                .iter()
                .map(|(joint, lever)| by[*joint].abs() * lever)
                .sum();
            let way = (first.ball().0 - last.ball().0).norm();
            assert!(way <= most + 1e-12, "{} {way} {most}", part.name);
        }
    }
}

#[test]
fn a_straight_way_comes_too_near_where_a_look_at_many_places_finds_it_so() {
    let ball = Solid::sphere(Vector3::new(0.6, 0.0, 0.67), 0.1);
    let mut scene = alone("puma560", vec![("ball".to_owned(), ball)]);
    let margins = vec![0.02; scene.names().len()];
    let (mut near, mut free) = (0, 0);
    for sample in 0..400 {
        let model = model("puma560");
        let ends = [spread(&model, sample), spread(&model, sample + 1000)];
        // Short ways: a place every few millimetres.
        let to = Joints::from_fn(6, |joint| {
            ends[0][joint] + 0.1 * (ends[1][joint] - ends[0][joint])
        });
        let found = scene.straight([&ends[0], &to], &margins);
        let mut least = f64::INFINITY;
        let mut distances = Vec::new();
        for step in 0..=200 {
            let share = f64::from(step) / 200.0;
            let at = Joints::from_fn(6, |joint| {
                ends[0][joint] + share * (to[joint] - ends[0][joint])
            });
            scene.distances(&at, &mut distances);
            least = distances.iter().copied().fold(least, f64::min);
        }
        // What lies between two places may be nearer by half of what moves between them.
        let moves: f64 = scene
            .levers()
            .iter()
            .zip(ends[0].iter().zip(&to))
            .map(|(lever, (from, to))| lever * (to - from).abs())
            .sum();
        let between = moves / PIECES as f64 / 2.0;
        match found {
            Some(found) => {
                assert!(least <= 0.02 + 1e-9, "{sample}: {found:?} {least}");
                near += 1;
            }
            None => {
                assert!(least > 0.02 - between, "{sample}: {least}");
                free += 1;
            }
        }
    }
    assert!(near > 5 && free > 20, "{near} {free}");
}

#[test]
fn a_solid_that_may_be_near_a_piece_of_the_room_stops_at_its_own_distance_and_all_others_at_the_margin()
 {
    let table = |top: f64| {
        let at = Placement::from_degrees([0.0, 0.0, top - 0.5], [0.0; 3]);
        let half = Vector3::new(5.0, 5.0, 0.5);
        alone(
            "puma560",
            vec![("table".to_owned(), Solid::Block { at, half })],
        )
    };
    // Stretched out and down from the shoulder: the wrist is lowest, and goes down.
    let bent = [0.0, -0.5, -std::f64::consts::FRAC_PI_2, 0.0, 0.0, 0.0];
    let pair = |scene: &Scene, one: &str| {
        let named = [one.to_owned(), "table".to_owned()];
        scene
            .names()
            .iter()
            .position(|pair| *pair == named)
            .unwrap()
    };
    let height = |shoulder: f64, one: &str| {
        let mut q = bent;
        q[1] = shoulder;
        let (mut scene, mut distances) = (table(-2.0), Vec::new());
        scene.distances(&Joints::try_from(q.as_slice()).unwrap(), &mut distances);
        distances[pair(&scene, one)] - 2.0
    };
    let down = if height(-0.49, "link6") < height(-0.5, "link6") {
        0.3
    } else {
        -0.3
    };
    assert!(height(-0.5, "link6") < height(-0.5, "link3"));
    let mut shown = at_rest(&bent);
    shown.velocity[1] = down;
    shown.stopping = braking(&shown.position, &shown.velocity, 0.1);
    let looked = |near: Option<f64>| {
        let lowest = height(-0.5, "link6").min(height(-0.5, "link4"));
        let mut scene = table(lowest - 0.025);
        for solid in ["link4", "link6"].into_iter().filter(|_| near.is_some()) {
            assert!(scene.keep(solid, "table", near.unwrap()));
        }
        assert!(!scene.keep("link7", "table", 0.0));
        scene.see(0, &shown, 0.0045, 0.0045);
        scene.look().touches.map(|near| near.margin)
    };
    assert_eq!(looked(None), Some(0.02));
    assert_eq!(looked(Some(0.02)), Some(0.02));
    assert_eq!(looked(Some(0.0)), None);
}
