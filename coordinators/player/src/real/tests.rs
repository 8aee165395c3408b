use std::{path::Path, sync::Arc};

use ctos::config;
use mcs::{
    Joints,
    model::{Placement, Solid},
    trajectory::Planner,
};
use mcs_collision::guard::Surroundings;
use mcs_path::{Refused, Space};
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
    space: Space,
    real: ArmArgs,
}

/// What the app keeps besides the margin of its watch where it looks ahead, m.
const AHEAD_M: f64 = 0.005;

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
    /// With jaws, and with more things in the room.
    fn of_the_app(more: Vec<(String, Solid)>) -> Self {
        Self::of("checkers-hands.toml", more)
    }

    fn of(app: &str, more: Vec<(String, Solid)>) -> Self {
        let configs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs");
        let file = configs.join(app);
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
        let servo = app.task("servo_arm").unwrap();
        let model = Arc::new(mcs::arm(servo, &app).unwrap());
        let ahead = around.margin + AHEAD_M;
        let space = Space::new(model, Vec::new(), around.room, ahead);
        Self {
            planner: mcs::planner(servo, &app).unwrap(),
            space: space.with_near(&around.near),
            real: args("robot").get("real").unwrap().parse().unwrap(),
        }
    }

    /// Where the arm is after motions, or what is in their way.
    fn ahead(&mut self, from: &Joints, motions: &[Plan]) -> Result<Joints, Refused> {
        mcs_path::ahead::look(&mut self.planner, &mut self.space, from, motions)
    }

    /// Where the arm waits, turned to the side of a place.
    fn park(&self, stand: Stand) -> Joints {
        let mut park = arm::radians(&self.real.park_deg);
        let [x, y] = stand.at;
        park[0] = y.atan2(x);
        park
    }

    /// Whether the fingers get down there in some turn, from where the arm waits but on this side, and up again and back to there.
    fn reach(&mut self, stand: Stand) -> Reach {
        let park = self.park(stand);
        let mut reach = Reach::Refused;
        for turn in self.real.turns_deg() {
            let down = stand.pose(turn);
            let over = at_height(down, TRAVEL_M);
            let line = PathKind::StraightLine;
            let ways = [(over, PathKind::Joint), (down, line), (over, line)];
            let mut motions = ways.map(|way| self.real.motion(way, 0.3)).to_vec();
            motions.push(self.real.parking());
            match self.ahead(&park, &motions) {
                Ok(_) => return Reach::Clear,
                Err(Refused::Touches { touch, .. }) => reach = Reach::Meets(touch.pair),
                Err(Refused::Unplanned { .. }) => {}
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
fn squares(board: &Pose, disc_m: f64) -> Vec<(Errand, Stand)> {
    let stand = |errand: &Errand| Stand::both(errand, &errand.ends(board), disc_m)[0];
    let all = (0..2).flat_map(|below| (0..32).map(move |square| (square, below)));
    let all = all.map(|(square, below)| errand(Spot::Board(centre(square)), below));
    all.map(|errand| (errand, stand(&errand))).collect()
}

/// Those of heaps and spare discs.
fn heaps(disc_m: f64) -> Vec<(Errand, Stand)> {
    let mut all = Vec::new();
    for hue in [Hue::Light, Hue::Dark] {
        let trays = (0..12).flat_map(|place| (0..2).map(move |below| (place, below)));
        all.extend(trays.map(|(place, below)| errand(Spot::Tray(hue, place), below)));
        all.extend((0..SPARE).map(|below| errand(Spot::Spare(hue), below)));
    }
    let stand = |errand: &Errand| Stand::both(errand, &errand.ends(&MIDDLE), disc_m)[0];
    all.into_iter()
        .map(|errand| (errand, stand(&errand)))
        .collect()
}

/// The games with hands: their apps, and how thick a pad or a fingertip is outwards and from side to side, m.
const HANDS: [(&str, [f64; 2]); 2] = [
    // A pad is 12 mm thick and 24 mm wide.
    ("checkers-hands.toml", [0.012, 0.024]),
    // A fingertip is a ball of 9 mm.
    ("checkers-fingers.toml", [0.018, 0.018]),
];

#[test]
fn every_square_heap_and_spare_disc_is_reached_clear_of_everything_when_the_board_is_in_the_middle()
{
    for (app, _) in HANDS {
        let mut around = Around::of(app, Vec::new());
        let disc_m = around.real.disc_m;
        let all = [squares(&MIDDLE, disc_m), heaps(disc_m)].concat();
        assert_eq!(all.len(), 64 + 48 + 24);
        for (errand, stand) in all {
            assert_eq!(around.reach(stand), Reach::Clear, "{app} {errand:?}");
        }
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
    for (app, _) in HANDS {
        let mut around = Around::of(app, Vec::new());
        let mut refused = 0;
        for board in boards() {
            for (errand, stand) in squares(&board, around.real.disc_m) {
                match around.reach(stand) {
                    Reach::Clear => {}
                    Reach::Refused => refused += 1,
                    Reach::Meets(met) => panic!("{app}: {met:?} for {errand:?} on {board:?}"),
                }
            }
        }
        assert!(refused > 0, "some of these boards are too far away");
    }
}

#[test]
fn open_fingertips_are_clear_of_neighbours_of_squares_heaps_and_spare_discs_however_they_are_turned()
 {
    for (app, [thick, wide]) in HANDS {
        // A disc has a radius of 20 mm.
        let open_m = Around::of(app, Vec::new()).real.gripper.open_m;
        let fingers = (0.5 * open_m + thick).hypot(0.5 * wide);
        let mut all: Vec<[f64; 2]> = heaps(disc_m()).iter().map(|(_, stand)| stand.at).collect();
        all.extend(squares(&MIDDLE, disc_m()).iter().map(|(_, stand)| stand.at));
        for one in &all {
            for other in &all {
                let off = crate::wire::apart(*one, *other);
                let is_the_same = off < 1e-9;
                let is_clear = is_the_same || off > fingers + 0.02;
                assert!(is_clear, "{app}: {one:?} {other:?}");
            }
        }
    }
}

#[test]
fn in_the_first_turn_no_finger_is_over_a_king_that_was_put_on_the_tray_before() {
    // So far out and so wide the last link of a finger is at the height of a king's top.
    let [out, half] = [0.0583, 0.009];
    for hue in [Hue::Light, Hue::Dark] {
        let at = |place: u8| Spot::Tray(hue, place).on_table(&MIDDLE);
        for place in 0..12 {
            let [x, y] = at(place);
            let links = [0.0_f64, 120.0, 240.0].map(|turn| {
                let (sin, cos) = turn.to_radians().sin_cos();
                [x + out * cos, y + out * sin]
            });
            for before in (0..place).map(at) {
                let near = links.map(|link| crate::wire::apart(link, before));
                assert!(
                    near.iter().all(|near| *near > 0.02 + half),
                    "{place} {near:?}"
                );
            }
        }
    }
}

#[test]
fn room_robot_and_cell_of_an_app_have_discs_of_one_height() {
    let configs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs");
    for (name, _) in HANDS {
        let app = config::load(&configs.join(name), &[], &[("vss", &VssExpander)]).unwrap();
        let args = |task: &str, key: &str| app.task(task).unwrap().args.get(key).unwrap().clone();
        let shown: crate::shown::ShownArgs = args("room", "shown").parse().unwrap();
        let real: ArmArgs = args("robot", "real").parse().unwrap();
        let cell: String = args("world", "cell").parse().unwrap();
        let cell = Cell::read(&configs.join(cell)).unwrap();
        let discs = cell
            .objects
            .iter()
            .filter(|object| crate::shown::is_disc(&object.name));
        let heights: Vec<f64> = discs
            .map(|disc| match disc.shape.solid {
                sim::shapes::Solid::Cylinder { half, .. } => 2.0 * half,
                other => panic!("{other:?}"),
            })
            .collect();
        assert_eq!(heights.len(), 48, "{name}");
        for height in heights.into_iter().chain([shown.disc_m]) {
            assert!((height - real.disc_m).abs() < 1e-9, "{name}: {height}");
        }
    }
}

#[test]
fn turned_by_a_part_of_the_circle_that_brings_each_finger_to_another_it_is_the_same_grasp() {
    let stand = Stand {
        at: [0.5, 0.1],
        bottom: 0.42,
        single: true,
    };
    for (app, _) in HANDS {
        let real = Around::of(app, Vec::new()).real;
        let fingers = f64::from(real.fingers);
        let turns = real.turns_deg();
        // Whatever the turn is now, no finger goes farther round than half way to the next.
        for now in 0..36 {
            let now = stand.pose(f64::from(now) * 10.0).rotation;
            let ways = ahead::turned(stand, &turns, real.fingers, &now);
            assert_eq!(ways.len(), turns.len() * usize::from(real.fingers));
            for (nth, _) in turns.iter().enumerate() {
                let mut same = ways.iter().filter(|(turn, _)| *turn == nth);
                let far = same.next().unwrap().1.rotation.angle_to(&now).to_degrees();
                assert!(far <= 180.0 / fingers + 1e-6, "{app}: {far} degrees");
            }
        }
        // No two turns are the same grasp.
        for (nth, one) in turns.iter().enumerate() {
            for other in &turns[nth + 1..] {
                let off = (one - other).rem_euclid(real.period_deg());
                assert!(off > 1.0 && real.period_deg() - off > 1.0, "{app}");
            }
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
    // 41 mm beside the middle, where the fingers are 29 mm and the disc 21 mm away; 25 mm are kept.
    let post = block("post", [0.546, 0.0, 0.594], [0.01, 0.01, 0.02]);
    let mut around = Around::of_the_app(vec![post]);
    let park = arm::radians(&around.real.park_deg);
    let above = around.real.motion((stand(0.75), PathKind::Joint), 0.3);
    let above = around.ahead(&park, &[above]).unwrap();
    let met = |around: &mut Around, z: f64| {
        let down = around.real.motion((stand(z), PathKind::StraightLine), 0.3);
        match around.ahead(&above, &[down]) {
            Err(Refused::Touches { touch, .. }) => Some(touch.pair),
            other => {
                other.unwrap();
                None
            }
        }
    };
    let pair = ["carried", "post"].map(str::to_owned);
    assert_eq!(met(&mut around, 0.6), Some(pair));
    assert_eq!(met(&mut around, 0.65), None);
    // The fingers alone would go past.
    let free = ("carried".to_owned(), "post".to_owned(), -1.0);
    around.space = around.space.with_near(&[free]);
    assert_eq!(met(&mut around, 0.6), None);
}

#[test]
fn after_a_stop_or_a_fault_no_other_way_is_tried_and_after_what_another_way_may_avoid_one_is() {
    let avoided = [
        Outcome::Unreachable,
        Outcome::Unseen,
        Outcome::Guard,
        Outcome::Refused,
        Outcome::Absent,
        Outcome::Occupied,
        Outcome::Stuck,
        Outcome::Blocked,
    ];
    for outcome in Outcome::ALL {
        let mut kept = Kept::default();
        let noted = kept.note(Failure::new(outcome, "why"));
        assert_eq!(noted.is_ok(), avoided.contains(&outcome), "{outcome}");
    }
}

#[test]
fn of_what_kept_the_arm_from_its_ways_a_thing_is_told_before_what_is_out_of_reach() {
    let stand = Stand {
        at: [0.5, 0.1],
        bottom: 0.42,
        single: true,
    };
    let told = |failures: &[(Outcome, &str)]| {
        let mut kept = Kept::default();
        for (outcome, reason) in failures {
            kept.note(Failure::new(*outcome, reason)).unwrap();
        }
        kept.told(stand)
    };
    let far = (Outcome::Unreachable, "too far");
    let post = (Outcome::Blocked, "a post");
    assert_eq!(
        told(&[far, post, (Outcome::Blocked, "a lamp")]).reason,
        "a post"
    );
    assert_eq!(
        told(&[far, (Outcome::Guard, "")]).outcome,
        Outcome::Unreachable
    );
    assert_eq!(told(&[]).outcome, Outcome::Unreachable);
}
