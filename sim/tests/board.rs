//! A draughts board and its discs in simulated pictures of calibrated cameras: what is found is held against where things are.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "helpers of tests, outside test functions"
)]

use std::path::Path;

use nalgebra::{Isometry3, Point2, Point3, Translation3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sim::{camera::Renderer, cell::Cell, scene::SceneState};
use vss::frame::Frame;
use vss_board::discs::{DiscForm, SeenDisc, bare, find_discs};
use vss_board::pose::{BoardForm, BoardPose, NoBoard, View, find_board};

const CELL: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../configs/carry-cell.toml");

/// Half the height of the board, and how far discs are above it.
const HALF: f64 = 0.01;
const FIELD: f64 = 0.06;
const FORM: BoardForm = BoardForm {
    field_m: FIELD,
    dot: [-0.255, -0.21],
    about_z: 0.42,
};

fn discs() -> DiscForm {
    DiscForm {
        radius_m: 0.018,
        height_m: 0.01,
        colours: vec![[190.0, 45.0, 40.0], [45.0, 75.0, 190.0]],
    }
}

/// Where discs may lie: on the board, on the table, on other discs.
const FLOORS: [f64; 5] = [0.0, -0.02, 0.01, 0.02, 0.03];

struct Table {
    cell: Cell,
    scene: SceneState,
    cameras: Vec<Renderer>,
    taken: u64,
}

impl Table {
    fn new() -> Self {
        let cell = Cell::read(Path::new(CELL)).unwrap();
        let cameras = cell.cameras.iter();
        let cameras = cameras
            .map(|camera| Renderer::new(&cell, camera, 1))
            .collect();
        Self {
            scene: cell.start(),
            cell,
            cameras,
            taken: 0,
        }
    }

    fn put(&mut self, name: &str, pose: Isometry3<f64>) {
        let mut bodies = self.scene.bodies.iter_mut();
        bodies.find(|body| body.name == name).unwrap().pose = pose;
    }

    /// Puts the board's surface there, turned by so much.
    fn board(&mut self, x: f64, y: f64, yaw: f64) -> Isometry3<f64> {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
        let surface = Isometry3::from_parts(Translation3::new(x, y, 0.42), turn);
        self.put("board", surface * Translation3::new(0.0, 0.0, -HALF));
        surface
    }

    /// Puts a disc's lower side there, in the board's frame.
    fn disc(&mut self, name: &str, board: &Isometry3<f64>, at: [f64; 3]) {
        let [x, y, z] = at;
        self.put(name, board * Translation3::new(x, y, z + 0.005));
    }

    fn views(&mut self, which: &[usize]) -> Vec<View> {
        self.taken += 1;
        let views = which.iter().map(|index| {
            let camera = &mut self.cameras[*index];
            let truth = self.cell.cameras[*index].truth.clone();
            let pixels = camera.render(&self.scene, self.taken);
            View {
                frame: Frame {
                    camera: truth.name.clone(),
                    ..Frame::rgb8(truth.width, truth.height, pixels)
                },
                camera: truth.camera(),
                position_sd: 0.0,
                rotation_sd: 0.0,
            }
        });
        views.collect()
    }
}

/// Shift in the plane (m) and turn (rad) between a board and where it was found.
fn off(truth: &Isometry3<f64>, found: &BoardPose) -> (f64, f64) {
    let by = truth.inverse() * found.base_t_board;
    (by.translation.vector.norm(), by.rotation.angle())
}

#[test]
fn a_board_anywhere_on_the_table_and_turned_any_way_is_found_as_well_as_its_standard_deviations_say()
 {
    let mut table = Table::new();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut squares = [0.0; 6];
    let runs = 5;
    for run in 0..runs {
        let (x, y) = (rng.random_range(0.5..0.7), rng.random_range(-0.2..0.2));
        let yaw = (f64::from(run) + rng.random_range(0.0..1.0)) * 1.257;
        let truth = table.board(x, y, yaw);
        for (name, column, row) in [("disc", 2.5, -1.5), ("other_disc", -0.5, 0.5)] {
            table.disc(name, &truth, [column * FIELD, row * FIELD, 0.0]);
        }
        let found = find_board(&table.views(&[0, 1]), &FORM);
        let found = found.unwrap_or_else(|error| panic!("{x} {y} {yaw}: {error}"));
        let (shift, turn) = off(&truth, &found);
        assert!(
            shift < 3e-4 && turn < 2e-3,
            "{x} {y} {yaw}: {shift} {turn} {found:?}"
        );
        assert!(found.corners > 60, "{found:?}");
        let turn = (truth.rotation * found.base_t_board.rotation.inverse()).scaled_axis();
        let shift = truth.translation.vector - found.base_t_board.translation.vector;
        for (k, off) in turn.iter().chain(shift.iter()).enumerate() {
            squares[k] += (off / found.sd[k]).powi(2) / f64::from(runs);
        }
    }
    for square in squares {
        // Of five draws; what is off systematically would be many times its standard deviation.
        assert!((0.05..6.0).contains(&square), "{squares:?}");
    }
}

#[test]
fn a_board_without_its_dot_or_out_of_sight_is_refused_with_the_reason() {
    let mut table = Table::new();
    table.board(0.55, 0.0, 0.4);
    let elsewhere = BoardForm {
        dot: [-0.255, 0.0],
        ..FORM
    };
    let views = table.views(&[0, 1]);
    assert_eq!(find_board(&views, &elsewhere), Err(NoBoard::Turned));
    let small = BoardForm {
        field_m: 0.03,
        ..FORM
    };
    let contradiction = find_board(&views, &small);
    assert!(
        matches!(
            contradiction,
            Err(NoBoard::Contradiction(..) | NoBoard::Turned)
        ),
        "{contradiction:?}"
    );
    table.put("board", Isometry3::translation(5.0, 5.0, 0.01));
    let unseen = find_board(&table.views(&[0, 1]), &FORM).unwrap_err();
    let said = unseen.to_string();
    assert!(
        said.contains("camera `left`") && said.contains("camera `right`"),
        "{said}"
    );
}

fn nearest(found: &[SeenDisc], at: [f64; 3]) -> Option<&SeenDisc> {
    let at = Point3::from(at);
    found
        .iter()
        .min_by(|a, b| (a.at - at).norm().total_cmp(&(b.at - at).norm()))
}

#[test]
fn discs_are_found_within_half_a_millimetre_with_their_colours_and_on_which_floor_they_lie() {
    let mut table = Table::new();
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let mut squares = 0.0;
    let mut count = 0.0;
    for run in 0..6 {
        let truth = table.board(
            rng.random_range(0.5..0.65),
            rng.random_range(-0.15..0.15),
            rng.random_range(-3.1..3.1),
        );
        let mut place = || rng.random_range(-0.2..0.2);
        let one = [place(), place(), 0.0];
        // Alone on the board, upon the other, or beside the board on the table.
        let other = match run % 3 {
            0 => [one[0] + 0.0005, one[1] - 0.0004, 0.01],
            1 => [0.3, -0.1, -0.02],
            _ => [-one[0], 0.07 - one[1], 0.0],
        };
        table.disc("disc", &truth, one);
        table.disc("other_disc", &truth, other);
        let views = table.views(&[0, 1]);
        let board = find_board(&views, &FORM).unwrap();
        let found = find_discs(&views, &board.base_t_board, &FLOORS, &discs());
        let hidden = run % 3 == 0;
        for (colour, at) in [(0, one), (1, other)] {
            if hidden && colour == 0 {
                continue;
            }
            let disc = nearest(&found, at).unwrap_or_else(|| panic!("{run}: {found:?}"));
            let off = disc.at - Point3::from(at);
            assert!(off.xy().norm() < 8e-4, "{run}: {at:?} {disc:?}");
            assert!(off.z.abs() < 1e-9, "{run}: {at:?} {found:?}");
            assert_eq!(disc.colour, colour, "{run}: {found:?}");
            squares += off.xy().norm_squared();
            count += 1.0;
        }
        let expected = if hidden { 1 } else { 2 };
        assert!(found.len() >= expected, "{run}: {found:?}");
    }
    let rms = f64::sqrt(squares / count);
    assert!(rms < 4e-4, "{rms}");
}

#[test]
fn a_place_that_is_bare_is_told_from_one_with_something_on_it() {
    let mut table = Table::new();
    let truth = table.board(0.55, 0.05, 1.0);
    table.disc("disc", &truth, [1.5 * FIELD, 0.5 * FIELD, 0.0]);
    table.disc("other_disc", &truth, [-2.5 * FIELD, 0.5 * FIELD, 0.0]);
    let views = table.views(&[0, 1]);
    let board = find_board(&views, &FORM).unwrap().base_t_board;
    let share = |x: f64, y: f64| {
        let place = Point2::new(x * FIELD, y * FIELD);
        bare(&views, &board, FIELD, place, 0.018).unwrap()
    };
    for (x, y) in [
        (0.5, 0.5),
        (-3.5, -3.5),
        (3.5, 3.5),
        (0.0, 0.0),
        (-1.5, 2.0),
    ] {
        assert!(share(x, y) > 0.9, "{x} {y}: {}", share(x, y));
    }
    for (x, y) in [(1.5, 0.5), (-2.5, 0.5), (1.4, 0.6)] {
        assert!(share(x, y) < 0.4, "{x} {y}: {}", share(x, y));
    }
}

#[test]
fn one_camera_alone_tells_where_a_disc_on_the_board_is() {
    let mut table = Table::new();
    let truth = table.board(0.55, 0.0, -0.6);
    let at = [0.5 * FIELD, 1.5 * FIELD, 0.0];
    table.disc("disc", &truth, at);
    let views = table.views(&[1]);
    let board = find_board(&views, &FORM).unwrap();
    let found = find_discs(&views, &board.base_t_board, &FLOORS, &discs());
    let disc = nearest(&found, at).unwrap();
    assert!((disc.at - Point3::from(at)).norm() < 1.5e-3, "{found:?}");
    assert_eq!((disc.colour, disc.cameras), (0, 1));
}
