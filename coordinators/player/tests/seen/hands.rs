//! Games in a world with physics: an arm and a gripper carry the discs.

use std::{
    path::Path,
    sync::{Arc, Mutex},
    time::Duration,
};

use checkers::{Game, Move, Numbering, Position, Variant};
use coordinators::dom::DomStore;
use ctos::{boot::Fault, task::Context};
use mcs::{Joints, client::Manipulator};
use mcs_hand::command::{Body, PlaceBody, ReadBodies};
use nalgebra::{Isometry3, Matrix4, Translation3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;

use super::play::{self, kill, record_of};

/// How often it is looked where the arm is.
const LOOK: Duration = Duration::from_millis(45);

/// What kept the arm from its errand, in words, and how far the joints have been from where the arm waits, rad.
type Hindered = Arc<Mutex<(String, f64)>>;

/// Looks at that.
async fn look_on(cx: Context, seen: Hindered) {
    let (arm, dom) = (
        Manipulator::find(&cx, "mcs").await.unwrap(),
        DomStore::new("dom"),
    );
    let begin = arm.position().await.unwrap().joints;
    while !cx.is_stopping() {
        cx.sleep(LOOK).await;
        let Ok(position) = arm.position().await else {
            continue;
        };
        let far = far(&position.joints, &begin).max(seen.lock().unwrap().1);
        // The kind is the number of a word.
        let kept = dom.fetch::<(u32, String)>(&cx, "hindrance").await;
        let mut seen = seen.lock().unwrap();
        *seen = (kept.map(|(_, text)| text).unwrap_or_default(), far);
    }
}

/// How far the joint is that is farthest from where it was, rad.
fn far(now: &Joints, begin: &Joints) -> f64 {
    let off = now.iter().zip(begin).map(|(now, then)| (now - then).abs());
    off.fold(0.0, f64::max)
}

#[test]
fn a_thing_on_the_way_of_a_carry_is_named_and_the_arm_has_not_moved() {
    let seen = Hindered::default();
    let shared = Arc::clone(&seen);
    let folder = tempfile::tempdir().unwrap();
    let opponent = record_of(folder.path(), 2);
    // A lamp hangs over the board.
    let room = "task.servo_arm.args.guards.collision.args.room=[\
        { name = \"table\", shapes = [{ box = [0.9, 1.6, 0.42], at = { xyz = [0.55, 0.0, 0.21] } }], \
          near = { fingers = -0.02, carried = -0.021 } }, \
        { name = \"lamp\", shapes = [{ box = [0.5, 0.5, 0.04], at = { xyz = [0.55, 0.0, 0.5] } }] }]";
    let sets = [
        "task.player_daemon.handler=\"test.onlooker\"",
        // By then the arm would be on its way with a disc.
        "task.operator.args.within_s=12",
        room,
        &opponent,
    ];
    play::simulated("checkers-hands.toml", 1, &sets, &[], |registry| {
        play::beside(registry, "test.onlooker", move |cx| {
            look_on(cx, Arc::clone(&shared))
        });
    });
    let (text, far) = seen.lock().unwrap().clone();
    assert!(text.contains("would come too near to lamp"), "{text}");
    assert!(far < 0.01, "{far} rad");
}

/// A game that is true, in which nothing but the jaws touched anything.
fn game(seed: u64, sets: &[&str], faults: &[Fault]) -> Value {
    game_of("checkers-hands.toml", seed, sets, faults)
}

fn game_of(app: &str, seed: u64, sets: &[&str], faults: &[Fault]) -> Value {
    let game = play::play(app, seed, sets, faults);
    assert_eq!(game["ok"], true, "{app}: {game:#}");
    game
}

/// A file with a game from a position, in which a man is crowned as soon as it can and a king goes as far as it can.
fn record_from(folder: &Path, fen: &str, plies: usize) -> String {
    let start = Position::read(fen, Variant::Brazilian, Numbering::Plain).unwrap();
    let game = Game::from(Variant::Brazilian, start);
    let far = |step: &Move| (step.crowned, step.from.abs_diff(step.to));
    play::record(folder, game, plies, |_, moves| {
        *moves.iter().max_by_key(|step| far(step)).unwrap()
    })
}

/// Where the middle of each disc on the board is beside that of a square, in the board's frame, m.
type Offsets = Arc<Mutex<Vec<[f64; 2]>>>;

/// Pushes all discs on the board aside, m, when the arm sets out for the second time; notes how they stand.
async fn push_aside(cx: Context, by: [f64; 2], offsets: Offsets) {
    let arm = Manipulator::find(&cx, "mcs").await.unwrap();
    let begin = arm.position().await.unwrap().joints;
    let world = cx.task("world").await.unwrap();
    let (mut away, mut ways) = (false, 0);
    while !cx.is_stopping() {
        cx.sleep(LOOK).await;
        let (Ok(position), Ok(bodies)) =
            (arm.position().await, cx.call(&world, ReadBodies {}).await)
        else {
            continue;
        };
        let pose = |body: &Body| -> Isometry3<f64> {
            nalgebra::try_convert(Matrix4::from_row_slice(&body.world_t_body)).unwrap()
        };
        let board = bodies.iter().find(|body| body.name == "board");
        let board = pose(board.unwrap());
        let discs = bodies.iter().filter(|body| {
            let is_disc = body.name.starts_with("light") || body.name.starts_with("dark");
            is_disc && (board.inverse() * pose(body)).translation.vector.amax() < 0.24
        });
        let is_away = far(&position.joints, &begin) > 0.2;
        ways += u32::from(is_away && !away);
        if ways == 2 && is_away && !away {
            for disc in discs.clone() {
                let pose = Translation3::new(by[0], by[1], 0.0) * pose(disc);
                let body = disc.name.clone();
                cx.call(&world, PlaceBody { body, pose }).await.unwrap();
            }
        }
        away = is_away;
        let off = discs.map(|disc| {
            let at = (board.inverse() * pose(disc)).translation;
            // The middles of squares are 0.06 m apart, and none is in the middle of the board.
            [at.x, at.y].map(|at| (at - 0.03 + 0.24).rem_euclid(0.06))
        });
        let off = off.map(|off| off.map(|at| if at > 0.03 { at - 0.06 } else { at }));
        *offsets.lock().unwrap() = off.collect();
    }
}

#[test]
fn a_disc_that_is_pushed_aside_when_the_arm_has_set_out_is_seen_by_the_hand_and_set_down_in_the_middle()
 {
    let offsets = Offsets::default();
    let sets = [
        "task.player_daemon.handler=\"test.pusher\"",
        "task.operator.args.within_s=46",
    ];
    let shared = Arc::clone(&offsets);
    play::simulated("checkers-hands.toml", 1, &sets, &[], |registry| {
        play::beside(registry, "test.pusher", move |cx| {
            push_aside(cx, [0.004, 0.004], Arc::clone(&shared))
        });
    });
    let offsets = offsets.lock().unwrap();
    let off = offsets.iter().map(|[x, y]| x.hypot(*y));
    let (middle, aside): (Vec<f64>, Vec<f64>) = off.partition(|off| *off < 0.002);
    // The camera has learned what it sees with the disc before, which was pushed aside, too.
    assert_eq!((middle.len(), aside.len()), (1, 23), "{offsets:?}");
    assert!(aside.iter().all(|off| *off > 0.005), "{offsets:?}");
}

#[test]
fn a_disc_that_stands_crooked_is_pushed_to_its_middle_by_closed_jaws_and_then_carried() {
    let folder = tempfile::tempdir().unwrap();
    let opponent = record_from(folder.path(), "W:W22,32:B1,12", 1);
    let aside = "task.room.args.aside=[{ square = 22, by = [0.012, -0.008] }]";
    let game = game(1, &[&opponent, aside], &[]);
    let said = game["said"].to_string();
    assert!(
        said.contains("I push the disc on 22 to the middle"),
        "{said}"
    );
    assert!(!said.contains("crooked"), "{said}");
}

#[test]
fn both_sides_are_crowned_with_spare_discs_and_kings_are_carried_and_capture() {
    let folder = tempfile::tempdir().unwrap();
    let opponent = record_from(folder.path(), "W:W6,22:B11,27", 4);
    let game = game(1, &[&opponent], &[]);
    assert_eq!(game["plies"], 4);
    let said = game["said"].to_string();
    assert!(!said.contains("lost"), "{said}");
}

#[test]
fn three_fingers_carry_single_discs_crown_men_of_both_sides_and_carry_the_king() {
    let folder = tempfile::tempdir().unwrap();
    let opponent = record_from(folder.path(), "W:W6,22:B11,27", 3);
    let game = game_of("checkers-fingers.toml", 1, &[&opponent], &[]);
    assert_eq!(game["plies"], 3);
    // A move with its crown, the crown of the other side, and a move of the king.
    assert_eq!(game["carry"][1], 4, "{game:#}");
    let said = game["said"].to_string();
    for word in ["lost", "please", "cannot"] {
        assert!(!said.contains(word), "{said}");
    }
}

#[test]
fn robot_hand_and_vision_that_die_while_a_disc_is_in_the_hand_come_back_and_the_game_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let opponent = record_of(folder.path(), 2);
    let kills = [kill("robot", 7.3), kill("vision", 8.0), kill("hand", 9.1)];
    let game = game(1, &[&opponent], &kills);
    assert_eq!(game["plies"], 2);
}

/// Games of so many half-moves, one seed after the other, until they have shown what is asked for. All are true, and in none anything but
/// the jaws touched anything.
fn games(plies: usize, sets: &[&str], mut shows: impl FnMut(&Value) -> bool) {
    let folder = tempfile::tempdir().unwrap();
    let opponent = record_of(folder.path(), plies);
    let sets = [sets, &[&opponent]].concat();
    let shown = (1..6).any(|seed| {
        let game = game(seed, &sets, &[]);
        assert_eq!(game["plies"], plies);
        shows(&game)
    });
    assert!(shown, "none of five games has shown it");
}

#[test]
fn a_person_who_reaches_in_and_an_emergency_stop_halt_the_arm_before_anything_touches_it() {
    let sets = ["task.room.args.reaches=0.4", "task.room.args.power=0.5"];
    let mut seen = [false; 2];
    games(1, &sets, |game| {
        let (said, errors) = (game["said"].to_string(), game["errors"].to_string());
        seen[0] |= errors.contains("reached in");
        seen[1] |= said.contains("needs power");
        seen == [true; 2]
    });
}

#[test]
fn discs_that_are_knocked_out_of_the_fingers_are_told_and_the_game_goes_on() {
    games(1, &["task.room.args.slips=0.6"], |game| {
        game["slipped"].as_u64().unwrap() > 0
    });
}

/// Games of the campaign; none unless `CTOS_CHECKERS_HANDS_SEEDS` says how many, or which (`A..B`): a game takes some minutes of a core.
fn seeds() -> std::ops::Range<u64> {
    let Ok(given) = std::env::var("CTOS_CHECKERS_HANDS_SEEDS") else {
        return 0..0;
    };
    match given.split_once("..") {
        Some((from, to)) => from.parse().unwrap()..to.parse().unwrap(),
        None => 0..given.parse().unwrap(),
    }
}

/// Every third game has all discs; the others begin with six of each side, of another opening.
const STARTS: [&str; 3] = [
    "W:W21-32:B1-12",
    "W:W18,21,22,26,29,30:B3,5,8,10,11,12",
    "W:W20,24,27,28,31,32:B1,2,6,7,9,13",
];

/// Daemons that die, at drawn moments.
fn kills(seed: u64) -> Vec<Fault> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut one = || {
        let daemon = play::DAEMONS[rng.random_range(0..play::DAEMONS.len())];
        let at_ms = rng.random_range(5_000..400_000);
        kill(daemon, f64::from(at_ms) / 1e3)
    };
    (0..4).map(|_| one()).collect()
}

#[test]
fn whole_games_with_hands_errors_lost_discs_moved_boards_and_kills_end_truly() {
    let mut failed = Vec::new();
    for seed in seeds() {
        let opponent = ["program", "self"][usize::from(seed % 4 == 3)];
        let opponent = format!("task.player.args.opponent=\"{opponent}\"");
        let start = format!("task.player.args.start={:?}", STARTS[seed as usize % 3]);
        let chances = [
            ("errors", 0.2),
            ("slips", 0.03),
            ("bumps", 0.01),
            ("glare", 0.02),
            ("power", 0.01),
            ("reaches", 0.03),
            ("lamps", 0.01),
        ];
        let chances = chances.map(|(key, chance)| format!("task.room.args.{key}={chance}"));
        let mut sets = vec![opponent.as_str(), start.as_str()];
        sets.extend(chances.iter().map(String::as_str));
        let ran = std::panic::catch_unwind(|| {
            let game = play::play("checkers-hands.toml", seed, &sets, &kills(seed));
            if let Ok(file) = std::env::var("CTOS_CHECKERS_SEEN_LOG") {
                std::fs::write(format!("{file}.hands.{seed}"), format!("{game:#}")).unwrap();
            }
            assert_eq!(game["ok"], true, "seed {seed}, {sets:?}: {game:#}");
        });
        if ran.is_err() {
            failed.push(seed);
        }
    }
    assert!(failed.is_empty(), "{failed:?}");
}
