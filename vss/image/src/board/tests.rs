//! Boards that a small renderer draws: in perspective, turned, with noise, shadows, hands and missing corners.

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, Normal};

use super::*;
use crate::{
    Format,
    colour::{Classes, Training},
};

/// What is drawn. Discs stand at the middle of squares.
struct Scene {
    /// Where the corners a1, h1, h8, a8 are, px.
    corners: [[f64; 2]; 4],
    size: (usize, usize),
    /// Codes of the pieces in PDN order.
    pieces: [i64; 32],
    noise: f64,
    /// How much of the light is left where u + v is above the sum of the sides' halves.
    shadow: f64,
    /// A hand: an ellipse about a place of the picture with two half axes, px.
    hand: Option<([f64; 2], [f64; 2])>,
    radius: f64,
    /// How far discs are from the middles of their squares, squares.
    shift: [f64; 2],
}

impl Default for Scene {
    fn default() -> Self {
        let mut pieces = [0; 32];
        for (nth, piece) in pieces.iter_mut().enumerate() {
            *piece = match nth {
                ..12 => 2,
                20.. => 1,
                _ => 0,
            };
        }
        Self {
            corners: [[90.0, 420.0], [560.0, 440.0], [480.0, 60.0], [150.0, 70.0]],
            size: (640, 480),
            pieces,
            noise: 4.0,
            shadow: 1.0,
            hand: None,
            radius: 0.38,
            shift: [0.0, 0.0],
        }
    }
}

const LIGHT: [f64; 3] = [225.0, 205.0, 170.0];
const DARK: [f64; 3] = [110.0, 75.0, 50.0];
const WHITE: [f64; 3] = [245.0, 245.0, 235.0];
const BLACK: [f64; 3] = [25.0, 25.0, 30.0];
const TABLE: [f64; 3] = [60.0, 110.0, 90.0];
const HAND: [f64; 3] = [215.0, 150.0, 125.0];

impl Scene {
    fn map(&self) -> Homography {
        let board = [[0.0, 0.0], [8.0, 0.0], [8.0, 8.0], [0.0, 8.0]];
        let pairs: Vec<_> = board.into_iter().zip(self.corners).collect();
        Homography::fitted(&pairs).unwrap()
    }

    fn colour(&self, [x, y]: [f64; 2]) -> [f64; 3] {
        if !(-0.4..8.4).contains(&x) || !(-0.4..8.4).contains(&y) {
            return TABLE;
        }
        if !(0.0..8.0).contains(&x) || !(0.0..8.0).contains(&y) {
            return [90.0, 50.0, 30.0];
        }
        let (file, rank) = (x.floor() as i32, y.floor() as i32);
        for (dx, dy) in [(0, 0), (-1, 0), (1, 0), (0, -1), (0, 1)] {
            let (file, rank) = (file + dx, rank + dy);
            if !(0..8).contains(&file) || !(0..8).contains(&rank) || (file + rank) % 2 != 0 {
                continue;
            }
            let piece = self.pieces[usize::try_from((7 - rank) * 4 + file / 2).unwrap()];
            let middle = [
                f64::from(file) + 0.5 + self.shift[0],
                f64::from(rank) + 0.5 + self.shift[1],
            ];
            let far = (x - middle[0]).hypot(y - middle[1]);
            if piece > 0 && far < self.radius {
                let white = piece % 2 == 1;
                let marked = piece > 2 && far < 0.14;
                return if white == marked { BLACK } else { WHITE };
            }
        }
        if (file + rank) % 2 == 0 { DARK } else { LIGHT }
    }

    fn drawn(&self) -> Picture {
        let (width, height) = self.size;
        let pairs: Vec<_> = self
            .corners
            .into_iter()
            .zip([[0.0, 0.0], [8.0, 0.0], [8.0, 8.0], [0.0, 8.0]])
            .collect();
        let back = Homography::fitted(&pairs).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let noise = Normal::new(0.0, self.noise).unwrap();
        let mut pixels = Vec::with_capacity(width * height * 3);
        for v in 0..height {
            for u in 0..width {
                let mut sum = [0.0; 3];
                for nth in 0..4_u8 {
                    let at = [
                        u as f64 + f64::from(nth % 2) / 2.0 - 0.25,
                        v as f64 + f64::from(nth / 2) / 2.0 - 0.25,
                    ];
                    let mut colour = self.colour(back.of(at));
                    if let Some((place, axes)) = self.hand {
                        let (x, y) = ((at[0] - place[0]) / axes[0], (at[1] - place[1]) / axes[1]);
                        if x.hypot(y) < 1.0 {
                            colour = HAND;
                        }
                    }
                    if at[0] + at[1] > (width + height) as f64 / 2.0 {
                        colour = colour.map(|one| one * self.shadow);
                    }
                    for (sum, one) in sum.iter_mut().zip(colour) {
                        *sum += one / 4.0;
                    }
                }
                for one in sum {
                    let drawn: f64 = noise.sample(&mut rng);
                    pixels.push((one + drawn).round().clamp(0.0, 255.0) as u8);
                }
            }
        }
        Picture {
            width,
            height,
            format: Format::Rgb8,
            pixels,
            notes: Vec::new(),
        }
    }
}

/// The codes that are read.
fn codes(board: &Board, picture: &Picture) -> [i64; 32] {
    board
        .situation(picture, None)
        .map(|field| field.piece.code())
}

/// The largest distance of the board's corners from where they were drawn, px.
fn off(board: &Board, scene: &Scene) -> f64 {
    let board_corners = [[0.0, 0.0], [8.0, 0.0], [8.0, 8.0], [0.0, 8.0]];
    let pairs = board_corners.iter().zip(scene.corners);
    let far = pairs.map(|([file, rank], [u, v])| {
        let at = board.pixel(*file, *rank);
        (at[0] - u).hypot(at[1] - v)
    });
    far.fold(0.0, f64::max)
}

#[test]
fn a_board_in_perspective_is_found_to_a_pixel_and_all_men_and_kings_are_read() {
    let mut scene = Scene::default();
    scene.pieces[3] = 4;
    scene.pieces[14] = 3;
    scene.pieces[25] = 0;
    let picture = scene.drawn();
    let board = Board::find(&picture, Side::Bottom).unwrap();
    assert!(off(&board, &scene) < 1.0, "{}", off(&board, &scene));
    assert!(
        board.corners >= 45 && board.rms < 0.5,
        "{} {}",
        board.corners,
        board.rms
    );
    assert_eq!(codes(&board, &picture), scene.pieces);
    for field in board.situation(&picture, None) {
        assert!(field.confidence > 0.5, "{field:?}");
    }
}

#[test]
fn a_turned_board_is_read_from_the_side_of_white() {
    let scene = Scene::default();
    let turned = |turn: usize| {
        let mut corners = [[100.0, 430.0], [540.0, 430.0], [540.0, 40.0], [100.0, 40.0]];
        corners.rotate_left(turn);
        Scene {
            corners,
            ..Scene::default()
        }
    };
    let sides = [Side::Bottom, Side::Left, Side::Top, Side::Right];
    for (turn, side) in sides.into_iter().enumerate() {
        let turned = turned(turn);
        let picture = turned.drawn();
        // a1 is where the first corner was drawn, and so is White's side.
        let near = [0, 1].map(|nth| turned.corners[nth]);
        let middle = [
            (near[0][0] + near[1][0]) / 2.0 - 320.0,
            (near[0][1] + near[1][1]) / 2.0 - 235.0,
        ];
        let expected = sides.into_iter().max_by(|a, b| {
            let along =
                |side: &Side| side.direction()[0] * middle[0] + side.direction()[1] * middle[1];
            along(a).total_cmp(&along(b))
        });
        let board = Board::find(&picture, expected.unwrap_or(side)).unwrap();
        assert!(
            off(&board, &turned) < 1.0,
            "{turn}: {}",
            off(&board, &turned)
        );
        assert_eq!(codes(&board, &picture), scene.pieces, "{turn}");
    }
    // By thirty degrees.
    let slanted = [[190.0, 465.0], [585.0, 235.0], [360.0, 15.0], [40.0, 220.0]];
    let slanted = Scene {
        corners: slanted,
        ..Scene::default()
    };
    let picture = slanted.drawn();
    let board = Board::find(&picture, Side::Bottom).unwrap();
    assert!(off(&board, &slanted) < 1.5, "{}", off(&board, &slanted));
    assert_eq!(codes(&board, &picture), slanted.pieces);
}

#[test]
fn shadow_and_noise_do_not_change_what_is_read() {
    for (shadow, noise) in [(0.55, 4.0), (1.0, 12.0), (0.7, 8.0)] {
        let scene = Scene {
            shadow,
            noise,
            ..Scene::default()
        };
        let picture = scene.drawn();
        let board = Board::find(&picture, Side::Bottom).unwrap();
        let wrong = codes(&board, &picture)
            .iter()
            .zip(scene.pieces)
            .filter(|(found, drawn)| *found != drawn)
            .count();
        assert!(off(&board, &scene) < 1.5);
        // Where the border of the shadow crosses a square nothing is claimed.
        assert!(
            wrong <= if shadow < 1.0 { 3 } else { 0 },
            "{shadow} {noise}: {wrong}"
        );
        let claims = codes(&board, &picture).into_iter().zip(scene.pieces);
        for (found, drawn) in claims {
            assert!(found == drawn || found == -1, "{found} for {drawn}");
        }
    }
}

#[test]
fn under_a_hand_squares_are_unknown_and_the_others_are_read() {
    let scene = Scene {
        hand: Some(([470.0, 380.0], [130.0, 110.0])),
        ..Scene::default()
    };
    let picture = scene.drawn();
    let board = Board::find(&picture, Side::Bottom).unwrap();
    assert!(off(&board, &scene) < 2.0, "{}", off(&board, &scene));
    let found = board.situation(&picture, None);
    let unknown = found
        .iter()
        .filter(|field| field.piece == Piece::Unknown)
        .count();
    assert!((3..=14).contains(&unknown), "{unknown}");
    for (field, drawn) in found.iter().zip(scene.pieces) {
        let code = field.piece.code();
        assert!(code == drawn || code == -1, "{code} for {drawn}");
        assert!(code != -1 || field.confidence == 0.0);
    }
}

#[test]
fn a_corner_outside_the_picture_leaves_its_squares_unknown() {
    let scene = Scene {
        corners: [[-60.0, 500.0], [470.0, 470.0], [420.0, 60.0], [30.0, 70.0]],
        ..Scene::default()
    };
    let picture = scene.drawn();
    let board = Board::find(&picture, Side::Bottom).unwrap();
    assert!(off(&board, &scene) < 2.5, "{}", off(&board, &scene));
    let found = codes(&board, &picture);
    // a1 is not in the picture.
    assert_eq!(found[28], -1);
    for (code, drawn) in found.iter().zip(scene.pieces) {
        assert!(*code == drawn || *code == -1, "{code} for {drawn}");
    }
    assert!(found.iter().filter(|code| **code == -1).count() <= 6);
}

#[test]
fn where_no_board_is_the_reason_is_told() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let empty = Picture {
        width: 320,
        height: 240,
        format: Format::Grey8,
        pixels: vec![90; 320 * 240],
        notes: Vec::new(),
    };
    let noise = Picture {
        pixels: (0..320 * 240).map(|_| rng.random()).collect(),
        ..empty.clone()
    };
    // A pattern of 5 x 5 squares.
    let small = Picture {
        pixels: (0..320 * 240)
            .map(|nth| {
                let (u, v) = (nth % 320, nth / 320);
                let inside = (60..260).contains(&u) && (20..220).contains(&v);
                match (u / 40 + (v + 20) / 40) % 2 {
                    _ if !inside => 90,
                    0 => 30,
                    _ => 220,
                }
            })
            .collect(),
        ..empty.clone()
    };
    let tiny = Picture {
        width: 2,
        height: 1,
        pixels: vec![0, 255],
        ..empty.clone()
    };
    for picture in [empty, noise, small, tiny] {
        let text = Board::find(&picture, Side::Bottom).unwrap_err().to_string();
        assert!(
            text.contains("inner corners") || text.contains("no board"),
            "{text}"
        );
    }
    // A hand over nearly all of it.
    let scene = Scene {
        hand: Some(([330.0, 260.0], [240.0, 200.0])),
        ..Scene::default()
    };
    let text = Board::find(&scene.drawn(), Side::Bottom)
        .unwrap_err()
        .to_string();
    assert!(text.contains("inner corners"), "{text}");
}

#[test]
fn a_disc_beside_the_middle_of_its_square_is_measured() {
    let mut pieces = [0; 32];
    (pieces[13], pieces[18]) = (1, 2);
    let scene = Scene {
        pieces,
        shift: [0.12, -0.08],
        radius: 0.36,
        ..Scene::default()
    };
    let picture = scene.drawn();
    let board = Board::find(&picture, Side::Bottom).unwrap();
    // 14 is d6... counted in PDN order from b8: row 3 from above, and 19 in row 4.
    for (nth, piece) in [(13, Piece::WhiteMan), (18, Piece::BlackMan)] {
        let (file, rank) = situation_place(nth);
        let disc = board.disc(file + 0.5, rank + 0.5).unwrap();
        assert!((disc.file - file - 0.62).abs() < 0.03, "{disc:?}");
        assert!((disc.rank - rank - 0.42).abs() < 0.03, "{disc:?}");
        assert_eq!(disc.piece, piece);
        let at = scene.map().of([file + 0.62, rank + 0.42]);
        assert!(
            (disc.u - at[0]).hypot(disc.v - at[1]) < 1.5,
            "{disc:?} {at:?}"
        );
        let edge = scene.map().of([file + 0.62 + 0.36, rank + 0.42]);
        let radius = (edge[0] - at[0]).hypot(edge[1] - at[1]);
        assert!(
            (disc.radius / radius - 1.0).abs() < 0.2,
            "{disc:?} {radius}"
        );
    }
    // An empty square has none, and neither has a place off the board.
    let (file, rank) = situation_place(16);
    let none = board.disc(file + 0.5, rank + 0.5).unwrap_err();
    assert!(matches!(none, BoardError::NoDisc { .. }), "{none}");
    assert!(matches!(
        board.disc(9.0, 1.0),
        Err(BoardError::Outside { .. })
    ));
    assert!(matches!(
        board.disc(f64::NAN, 1.0),
        Err(BoardError::Outside { .. })
    ));
}

#[test]
fn the_place_of_a_disc_is_as_good_as_its_standard_deviations_say() {
    let (mut squares, mut count) = ([0.0; 2], 0.0);
    for shift in [[0.07, -0.03], [-0.045, 0.06]] {
        let scene = Scene {
            shift,
            radius: 0.36,
            ..Scene::default()
        };
        let picture = scene.drawn();
        let board = Board::find(&picture, Side::Bottom).unwrap();
        for nth in (0..12).chain(20..32) {
            let (file, rank) = situation_place(nth);
            let truth = [file + 0.5 + shift[0], rank + 0.5 + shift[1]];
            let disc = board.disc(file + 0.5, rank + 0.5).unwrap();
            let at = scene.map().of(truth);
            for (k, error) in [disc.u - at[0], disc.v - at[1]].into_iter().enumerate() {
                assert!(
                    error.abs() < 0.5 && disc.sd_px[k] < 0.3,
                    "{nth} {disc:?} {at:?}"
                );
                squares[k] += (error / disc.sd_px[k]).powi(2);
            }
            count += 1.0;
        }
        // Empty squares have none, dark ones and light ones.
        for nth in 13..19 {
            let (file, rank) = situation_place(nth);
            for side in [0.5, 1.5] {
                let none = board.disc(file + side, rank + 0.5);
                let outside = file + side > 8.0;
                assert!(
                    outside || matches!(none, Err(BoardError::NoDisc { .. })),
                    "{nth} {none:?}"
                );
            }
        }
    }
    for square in squares {
        let rms = f64::sqrt(square / count);
        assert!((0.5..1.6).contains(&rms), "{rms}");
    }
}

#[test]
fn a_disc_is_found_near_a_place_of_a_picture_without_a_board() {
    // Seen from above, near: squares of 160 px.
    let scene = Scene {
        corners: [
            [-300.0, 900.0],
            [980.0, 900.0],
            [980.0, -380.0],
            [-300.0, -380.0],
        ],
        shift: [0.05, 0.02],
        ..Scene::default()
    };
    let picture = scene.drawn();
    let map = scene.map();
    for nth in [20, 21, 24, 25] {
        let (file, rank) = situation_place(nth);
        let truth = map.of([file + 0.55, rank + 0.52]);
        if !(70.0..570.0).contains(&truth[0]) || !(70.0..410.0).contains(&truth[1]) {
            continue;
        }
        let radius = 160.0 * scene.radius;
        let disc = disc_near(&picture, [truth[0] + 20.0, truth[1] - 15.0], 0.9 * radius).unwrap();
        assert!(
            (disc.u - truth[0]).hypot(disc.v - truth[1]) < 0.3,
            "{disc:?} {truth:?}"
        );
        assert!(
            (disc.radius / radius - 1.0).abs() < 0.02,
            "{disc:?} {radius}"
        );
        assert_eq!(disc.piece, Piece::WhiteMan);
        assert!(
            disc.sd_px.iter().all(|sd| (0.01..0.3).contains(sd)),
            "{disc:?}"
        );
    }
    let text = disc_near(&picture, [320.0, 240.0], 200.0)
        .unwrap_err()
        .to_string();
    assert!(text.contains("no disc of about 200.0 px radius"), "{text}");
    assert!(disc_near(&picture, [f64::NAN, 10.0], 20.0).is_err());
    assert!(disc_near(&picture, [-900.0, 10.0], 20.0).is_err());
}

#[test]
fn four_markers_give_the_board_whatever_their_order_and_the_side_of_white() {
    let scene = Scene::default();
    let picture = scene.drawn();
    let map = scene.map();
    let places = [[-0.7, -0.6], [8.7, -0.8], [8.6, 8.7], [-0.9, 8.5]];
    let markers = places.map(|place| map.of(place));
    let [a, b, c, d] = markers;
    for order in [[a, b, c, d], [c, a, d, b], [d, c, b, a]] {
        let board = Board::at_markers(&picture, order, &places, Side::Bottom).unwrap();
        assert!(
            board.corners >= 40 && board.rms < 0.5,
            "{} {}",
            board.corners,
            board.rms
        );
        for place in [[0.0, 0.0], [8.0, 0.0], [4.0, 4.0], [0.0, 8.0]] {
            let (found, truth) = (board.pixel(place[0], place[1]), map.of(place));
            assert!((found[0] - truth[0]).hypot(found[1] - truth[1]) < 1e-6);
        }
        assert_eq!(codes(&board, &picture), scene.pieces);
    }
    // Markers that are as far out on all sides fit turned by half, too.
    let places = [[-0.7, -0.7], [8.7, -0.7], [8.7, 8.7], [-0.7, 8.7]];
    let markers = places.map(|place| map.of(place));
    let board = Board::at_markers(&picture, markers, &places, Side::Top).unwrap();
    let (found, truth) = (board.pixel(0.0, 0.0), map.of([8.0, 8.0]));
    assert!((found[0] - truth[0]).hypot(found[1] - truth[1]) < 1e-6);
    // Others that look like markers are none.
    let mut some = markers.to_vec();
    some.insert(1, [20.0, 20.0]);
    some.push([600.0, 200.0]);
    let (board, four) = Board::at_some_markers(&picture, &some, &places, Side::Bottom).unwrap();
    assert_eq!(four, [0, 2, 3, 4]);
    assert!(board.inner_corners().len() >= 40);
    for wrong in [
        [[20.0, 20.0], [600.0, 20.0], [600.0, 300.0], [30.0, 310.0]],
        [[5.0, 5.0]; 4],
        [[f64::NAN, 5.0]; 4],
    ] {
        assert!(Board::at_markers(&picture, wrong, &places, Side::Bottom).is_err());
    }
}

/// The lower left corner of a playing square.
fn situation_place(nth: i32) -> (f64, f64) {
    let row = nth / 4;
    let file = 2 * (nth % 4) + i32::from(row % 2 == 0);
    (f64::from(file), f64::from(7 - row))
}

#[test]
fn red_discs_that_are_as_light_as_their_squares_are_read_with_trained_colours_and_without() {
    let mut scene = Scene::default();
    scene.pieces[5] = 4;
    let mut picture = scene.drawn();
    // Black discs become red.
    for rgb in picture.pixels.chunks_exact_mut(3) {
        if rgb.iter().all(|sample| *sample < 60) {
            rgb.copy_from_slice(&[190, 45, 40]);
        }
    }
    let names = ["white", "black", "dark", "light", "background"].map(str::to_owned);
    let shown = [WHITE, [190.0, 45.0, 40.0], DARK, LIGHT, TABLE];
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let mut samples = Vec::new();
    for (class, rgb) in shown.iter().enumerate() {
        for _ in 0..40 {
            let light = rng.random_range(0.9..1.0);
            samples.push((
                class,
                rgb.map(|one| one * light + rng.random_range(0.0..6.0)),
            ));
        }
    }
    let samples: Vec<_> = samples
        .into_iter()
        .map(|(class, rgb)| (class, rgb.map(|one| one.min(255.0))))
        .collect();
    let classes = Classes::train(&names, &samples, &Training::default()).unwrap();
    let roles = Roles::of(&classes).unwrap();
    let board = Board::find(&picture, Side::Bottom).unwrap();
    let found = board.situation(&picture, Some((&classes, &roles)));
    assert_eq!(found.map(|field| field.piece.code()), scene.pieces);
    // Without training their colour still tells that they are there.
    assert_eq!(codes(&board, &picture), scene.pieces);
    let other = Classes::train(
        &["white".to_owned(), "table".to_owned()],
        &[(0, WHITE), (0, LIGHT), (1, TABLE), (1, DARK)],
        &Training::default(),
    );
    assert_eq!(Roles::of(&other.unwrap()), Err("black"));
}

/// A mirrored board looks as one that is turned by a quarter, on which White cannot sit below.
#[test]
fn a_mirrored_picture_of_a_board_is_refused() {
    let picture = Scene::default().drawn();
    let side = Side::Bottom;
    let seen = |picture: &Picture| Board::find(picture, side)?.facing(side);
    assert!(seen(&picture).is_ok());
    let bytes = picture.pixels.len() / (picture.width * picture.height);
    let mut mirrored = picture.clone();
    let rows = picture.pixels.chunks(picture.width * bytes);
    mirrored.pixels = rows
        .flat_map(|row| row.rchunks(bytes).flatten().copied().collect::<Vec<u8>>())
        .collect();
    assert_eq!(seen(&mirrored).err(), Some(BoardError::Sideways));
}
