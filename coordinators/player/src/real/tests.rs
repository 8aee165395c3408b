use std::{path::Path, sync::Arc};

use ctos::config;
use mcs::{
    Joints,
    model::{Model, Placement, Solid},
    trajectory::{CartesianLimits, Goal, Pace, Planner, Route, Segment},
};
use mcs_collision::{guard::Surroundings, scene::Scene};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sim::cell::Cell;
use vss::catalog::VssExpander;

use super::*;
use crate::{
    state::SPARE,
    table::MIDDLE,
    wire::{Hue, Pose, centre},
};

/// The arm of the app, and what stands around it.
struct Around {
    planner: Planner,
    scene: Scene,
    names: Vec<[String; 2]>,
    /// What each pair of solids keeps, m.
    margins: Vec<f64>,
    park: Joints,
}

/// How the fingers get down to a place.
#[derive(Debug, Clone, PartialEq)]
enum Reach {
    /// Clear of everything.
    Clear,
    /// No pose of the arm does that, which the app tells before it sets out.
    Refused,
    /// A way there is, and on it these two meet.
    Meets([String; 2]),
}

fn block(name: &str, [x, y, z]: [f64; 3], edges: [f64; 3]) -> (String, Solid) {
    let solid = Solid::Block {
        at: Placement::shifted(x, y, z),
        half: edges.map(|edge| 0.5 * edge).into(),
    };
    (name.to_owned(), solid)
}

impl Around {
    /// With more things in the room.
    fn of_the_app(more: Vec<(String, Solid)>) -> Self {
        let configs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs");
        let file = configs.join("checkers-hands.toml");
        let app = config::load(&file, &[], &[("vss", &VssExpander)]).unwrap();
        let args = |task: &str| &app.task(task).unwrap().args;
        let guards = args("servo_arm").get("guards").unwrap();
        let guard = guards.get("collision").unwrap().get("args").unwrap();
        let mut around = Surroundings::read(guard).unwrap();
        around.room.extend(more);
        let cell = Cell::read(&configs.join("checkers-seen-cell.toml")).unwrap();
        for name in ["left", "right", "far"] {
            let camera = cell.camera(name).unwrap().truth.camera();
            let eye = camera.centre.coords.into();
            around.room.push(block(name, eye, [0.1; 3]));
        }
        let model: Arc<Model> = Arc::new(mcs::manipulator(&app).unwrap());
        let base = (Arc::clone(&model), Placement::identity());
        let scene = Scene::new([base], around.room, around.margin);
        let names = scene.names();
        let margin = |[solid, piece]: &[String; 2]| {
            let mut near = around.near.iter();
            let own = near.find(|own| own.0 == *solid && own.1 == *piece);
            own.map_or(around.margin, |own| own.2)
        };
        let real: ArmArgs = args("robot").get("real").unwrap().parse().unwrap();
        Self {
            planner: Planner::new(model, CartesianLimits::default(), 0.018).unwrap(),
            margins: names.iter().map(margin).collect(),
            names,
            scene,
            park: arm::radians(&real.park_deg),
        }
    }

    /// The way, and where it ends.
    fn way(
        &mut self,
        from: &Joints,
        to: Isometry3<f64>,
        path: PathKind,
    ) -> Option<(Segment, Joints)> {
        let route = Route {
            goal: Goal::Pose(to),
            path,
            pace: Pace::new(0.3, None),
            elbow: None,
        };
        self.planner.segment(from, &route).ok()
    }

    /// What comes nearer than it may at a position.
    fn met_at(&mut self, position: &Joints) -> Option<[String; 2]> {
        let mut distances = Vec::new();
        self.scene.distances(position, &mut distances);
        let mut pairs = distances.iter().zip(&self.margins);
        let met = pairs.position(|(off, least)| off < least);
        met.and_then(|pair| self.names.get(pair).cloned())
    }

    /// What meets on a way.
    fn met(&mut self, from: &Joints, way: &Segment) -> Option<[String; 2]> {
        let (mut solver, mut near) = (self.planner.solver().clone(), *from);
        (0..=60).find_map(|step| {
            let time = way.duration() * f64::from(step) / 60.0;
            near = way.at(&mut solver, time, &near).unwrap().position;
            self.met_at(&near)
        })
    }

    /// Whether the fingers get down there, and up again, in some turn, from where the arm waits but on this side.
    fn reach(&mut self, stand: Stand) -> Reach {
        let mut park = self.park;
        let [x, y] = stand.at;
        park[0] = y.atan2(x);
        let mut reach = Reach::Refused;
        for turn in TURNS_DEG {
            let down = stand.pose(turn);
            let Some((there, over)) = self.way(&park, at_height(down, TRAVEL_M), PathKind::Joint)
            else {
                continue;
            };
            let Some((down, _)) = self.way(&over, down, PathKind::StraightLine) else {
                continue;
            };
            match self.met(&park, &there).or_else(|| self.met(&over, &down)) {
                None => return Reach::Clear,
                Some(met) => reach = Reach::Meets(met),
            }
        }
        reach
    }
}

fn errand(spot: Spot, below: u8) -> Errand {
    Errand {
        number: 1,
        from: spot,
        to: spot,
        discs: 1,
        below: [below; 2],
        push: false,
    }
}

/// The places of the squares, on each a disc and one that is set on it.
fn squares(board: &Pose) -> Vec<(Errand, Stand)> {
    let all = (0..2).flat_map(|below| (0..32).map(move |square| (square, below)));
    let all = all.map(|(square, below)| errand(Spot::Board(centre(square)), below));
    all.map(|errand| (errand, Stand::both(&errand, &errand.ends(board))[0]))
        .collect()
}

/// Those of heaps and spare discs.
fn heaps() -> Vec<(Errand, Stand)> {
    let mut all = Vec::new();
    for hue in [Hue::Light, Hue::Dark] {
        let trays = (0..12).flat_map(|place| (0..2).map(move |below| (place, below)));
        all.extend(trays.map(|(place, below)| errand(Spot::Tray(hue, place), below)));
        all.extend((0..SPARE).map(|below| errand(Spot::Spare(hue), below)));
    }
    let stand = |errand: &Errand| Stand::both(errand, &errand.ends(&MIDDLE))[0];
    all.into_iter()
        .map(|errand| (errand, stand(&errand)))
        .collect()
}

#[test]
fn every_square_heap_and_spare_disc_is_reached_clear_of_everything_when_the_board_is_in_the_middle()
{
    let mut around = Around::of_the_app(Vec::new());
    let all = [squares(&MIDDLE), heaps()].concat();
    assert_eq!(all.len(), 64 + 48 + 24);
    for (errand, stand) in all {
        assert_eq!(around.reach(stand), Reach::Clear, "{errand:?}");
    }
}

/// Where the board is laid or pushed, and farther.
fn boards() -> Vec<Pose> {
    let mut rng = ChaCha8Rng::seed_from_u64(24);
    let mut drawn = || Pose {
        at: [rng.random_range(0.4..0.95), rng.random_range(-0.15..0.15)],
        yaw: rng.random_range(-0.5..0.5),
        mirrored: false,
    };
    (0..6).map(|_| drawn()).collect()
}

#[test]
fn wherever_the_board_lies_each_square_has_a_way_that_is_clear_of_everything_or_none_at_all() {
    let mut around = Around::of_the_app(Vec::new());
    let mut refused = 0;
    for board in boards() {
        for (errand, stand) in squares(&board) {
            match around.reach(stand) {
                Reach::Clear => {}
                Reach::Refused => refused += 1,
                Reach::Meets(met) => panic!("{met:?} for {errand:?} on {board:?}"),
            }
        }
    }
    assert!(refused > 0, "some of these boards are too far away");
}

#[test]
fn open_fingers_are_clear_of_neighbours_of_squares_heaps_and_spare_discs_however_they_are_turned() {
    // A pad is 12 mm thick and 24 mm wide; a disc has a radius of 20 mm.
    let fingers = (0.5 * GripperArgs::default().open_m + 0.012).hypot(0.012);
    let mut all: Vec<[f64; 2]> = heaps().iter().map(|(_, stand)| stand.at).collect();
    all.extend(squares(&MIDDLE).iter().map(|(_, stand)| stand.at));
    for one in &all {
        for other in &all {
            let off = crate::wire::apart(*one, *other);
            let is_the_same = off < 1e-9;
            assert!(is_the_same || off > fingers + 0.02, "{one:?} {other:?}");
        }
    }
}

#[test]
fn what_only_the_carried_disc_would_touch_is_seen_by_the_watch_and_without_the_disc_nothing_is() {
    let stand = |z: f64| {
        Isometry3::from_parts(
            Translation3::new(0.5, 0.0, z),
            UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.0, 0.0),
        )
    };
    // 36 mm beside the middle, where the fingers are 24 mm and the disc 16 mm away; 20 mm are kept.
    let post = block("post", [0.541, 0.0, 0.594], [0.01, 0.01, 0.02]);
    let mut around = Around::of_the_app(vec![post]);
    let park = around.park;
    let (_, at) = around.way(&park, stand(0.6), PathKind::Joint).unwrap();
    let [carried, piece] = around.met_at(&at).unwrap();
    assert_eq!([carried.as_str(), piece.as_str()], ["carried", "post"]);
    let (_, higher) = around.way(&park, stand(0.65), PathKind::Joint).unwrap();
    assert_eq!(around.met_at(&higher), None);
    // The fingers alone would go past.
    for (pair, margin) in around.names.iter().zip(&mut around.margins) {
        if pair.first().is_some_and(|solid| solid == "carried") {
            *margin = f64::NEG_INFINITY;
        }
    }
    assert_eq!(around.met_at(&at), None);
}
