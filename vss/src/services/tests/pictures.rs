//! Pictures of every format by the textual requests of the classes that read them; the classes `colour` and `board`.

use super::*;

/// A grey picture as a PGM, a BMP and a PNG.
fn as_each_format(width: usize, height: usize, pixels: &[u8]) -> Vec<(&'static str, Vec<u8>)> {
    let mut pgm = format!("P5\n# a comment\n{width} {height}\n255\n").into_bytes();
    pgm.extend(pixels);
    let mut bmp = b"BM".to_vec();
    let side = |length: usize| i32::try_from(length).unwrap();
    for number in [0, 0, 54 + 1024, 40, side(width), -side(height)] {
        bmp.extend(number.to_le_bytes());
    }
    bmp.extend([1_u16.to_le_bytes(), 8_u16.to_le_bytes()].concat());
    bmp.extend([0; 24]);
    bmp.extend((0..=255_u8).flat_map(|grey| [grey, grey, grey, 0]));
    for row in pixels.chunks_exact(width) {
        bmp.extend(row);
        bmp.extend(vec![0; row.len().next_multiple_of(4) - row.len()]);
    }
    let mut png = Vec::new();
    crate::png::write(&mut png, width, height, pixels).unwrap();
    vec![("a.pgm", pgm), ("a.bmp", bmp), ("a.png", png)]
}

#[test]
fn every_format_gives_the_same_blobs_and_spots_whatever_the_file_is_called() {
    let mut pixels = vec![10_u8; 40 * 30];
    for v in 10..15 {
        for u in 20..27 {
            pixels[v * 40 + u] = 200;
        }
    }
    let sorm = manager();
    let answers: Vec<(Vec<f64>, Vec<f64>)> = as_each_format(40, 30, &pixels)
        .into_iter()
        .map(|(_, bytes)| {
            let (_folder, path) = file("picture.jpg", &bytes);
            let blobs = ask(&sorm, &format!("blobs EXEC {path}"));
            let spots = ask(&sorm, &format!("spot EXEC {path}"));
            assert!(blobs.is_ok() && spots.is_ok(), "{:?}", blobs.reports);
            assert!(blobs.reports.is_empty());
            (blobs.floats, spots.floats)
        })
        .collect();
    assert_eq!(answers[0].0[..3], [35.0, 23.0, 12.0]);
    assert!(answers.iter().all(|one| *one == answers[0]));
}

#[test]
fn what_a_reader_changes_is_a_warning_and_what_is_cut_is_an_error_with_its_file() {
    let sorm = manager();
    let (_folder, path) = file("deep.pgm", b"P5 2 1 65535\n\xff\xff\x00\x00");
    let reply = ask(&sorm, &format!("blobs EXEC {path}"));
    assert_eq!((reply.code, &reply.ints[..]), (0, &[1][..]));
    let report = &reply.reports[0];
    assert_eq!(report.code, code::PICTURE);
    assert!(
        report.text.contains(&path) && report.text.contains("multiplied by 255/65535"),
        "{report:?}"
    );
    let (_folder, path) = file("cut.pgm", b"P5 20 10 255\n123");
    let (number, text) = refused(&sorm, &format!("blobs EXEC {path}"));
    assert_eq!(number, code::FILE);
    assert!(
        text.contains(&path) && text.contains("200 bytes, and 3 are there; write or copy it again"),
        "{text}"
    );
    let (_folder, path) = file("huge.pgm", b"P5 100000 100000 255\n123");
    let (_, text) = refused(&sorm, &format!("spot EXEC {path}"));
    assert!(text.contains("100000 x 100000 pixels"), "{text}");
}

const SAMPLES: &str = "class,r,g,b\n\
    # two colours and what is around them\n\
    red,200,20,20\nred,210,30,25\nred,190,15,20\n\
    blue,20,30,200\nblue,25,35,210\nblue,15,25,190\n\
    table,120,120,120\ntable,130,130,128\ntable,110,112,110\n";

/// A colour picture of stripes: red, blue, grey, green, each as wide as given.
fn stripes(widths: [usize; 4]) -> Vec<u8> {
    let colours = [[201, 22, 20], [20, 30, 201], [122, 121, 120], [20, 250, 20]];
    let row: Vec<u8> = colours
        .iter()
        .zip(widths)
        .flat_map(|(rgb, width)| rgb.repeat(width))
        .collect();
    let width: usize = widths.iter().sum();
    let mut bytes = format!("P6 {width} 10 255\n").into_bytes();
    bytes.extend(row.repeat(10));
    bytes
}

#[test]
fn colour_counts_the_pixels_of_each_class_and_the_unknown_ones() {
    let sorm = manager();
    let (_samples, samples) = file("samples.csv", SAMPLES.as_bytes());
    let (_picture, path) = file("stripes.ppm", &stripes([5, 7, 20, 3]));
    let (number, text) = refused(&sorm, &format!("colour EXEC {path}"));
    assert_eq!(number, code::COLOURS);
    assert!(text.contains("train them with CTRL -train FILE"), "{text}");
    let trained = ask(&sorm, &format!("colour CTRL -train {samples}"));
    assert!(
        trained.is_ok() && trained.reports.is_empty(),
        "{:?}",
        trained.reports
    );
    let reply = ask(&sorm, &format!("colour EXEC TMSG {path}"));
    assert!(reply.is_ok(), "{:?}", reply.reports);
    assert_eq!(reply.ints, [50, 70, 200, 30]);
    assert_eq!(reply.text, "red blue table");
    assert!(
        reply.floats[..3].iter().all(|confidence| *confidence > 0.8),
        "{:?}",
        reply.floats
    );
    assert_eq!(ask(&sorm, "colour EXEC names").text, "red blue table");
    let pixel = ask(&sorm, "colour EXEC pixel FMSG 3 22 31 199");
    assert_eq!((&pixel.ints[..], pixel.text.as_str()), (&[1][..], "blue"));
    assert_eq!(ask(&sorm, "colour EXEC pixel FMSG 3 0 255 0").ints, [-1]);
    assert!(!ask(&sorm, "colour EXEC pixel FMSG 3 0 256 0").is_ok());
    // A table that is no good leaves the classes as they were.
    let (_wrong, wrong) = file("wrong.csv", b"class,r,g,b\nred,1,2,3\nred,3,2,1\n");
    let (number, text) = refused(&sorm, &format!("colour CTRL -train {wrong}"));
    assert_eq!(number, code::COLOURS);
    assert!(text.contains("only class `red` has samples"), "{text}");
    assert_eq!(
        ask(&sorm, &format!("colour EXEC {path}")).ints,
        [50, 70, 200, 30]
    );
    assert!(ask(&sorm, "colour CTRL -dump").text.contains(&samples));
}

#[test]
fn a_wrong_table_of_colours_is_refused_at_its_places() {
    let sorm = manager();
    for (text, place, what) in [
        ("", "1:1", "must name the columns class,r,g,b"),
        ("red,1,2,3\n", "1:1", "must name the columns"),
        ("class,r,g\nred,1,2\n", "1:1", "must name the columns"),
        (
            "class,r,g,b\nred,1,2\n",
            "2:1",
            "3 values stand here, and 4",
        ),
        (
            "class,r,g,b\nred,1,2,256\n",
            "2:9",
            "b must be a number from 0 to 255, not `256`",
        ),
        (
            "class,r,g,b\nred,-1,2,3\n",
            "2:5",
            "r must be a number from 0 to 255, not `-1`",
        ),
        (
            "class,r,g,b\nred,1,NaN,3\n",
            "2:7",
            "g must be a number from 0 to 255, not `NaN`",
        ),
        ("class,r,g,b\nred,1,,3\n", "2:7", "not ``"),
        ("class,r,g,b\n,1,2,3\n", "2:1", "class must be one word"),
    ] {
        let (_folder, path) = file("samples.csv", text.as_bytes());
        let (number, said) = refused(&sorm, &format!("colour CTRL -train {path}"));
        assert_eq!(number, code::TABLE, "{text}");
        assert!(
            said.contains(&format!("{path}:{place}")) && said.contains(what),
            "{text}: {said}"
        );
    }
    let (_folder, path) = file(
        "one.csv",
        b"class,r,g,b\nred,1,2,3\nblue,3,2,1\nblue,5,2,9\n",
    );
    let (_, text) = refused(&sorm, &format!("colour CTRL -train {path}"));
    assert!(text.contains("class `red` has one sample only"), "{text}");
    // Classes that overlap are learned, and that is told.
    let overlapping: String = (0..20)
        .map(|n| format!("{},{n},{n},{n}\n", if n % 3 == 0 { "a" } else { "b" }))
        .collect();
    let (_folder, path) = file(
        "overlapping.csv",
        format!("class,r,g,b\n{overlapping}").as_bytes(),
    );
    let reply = ask(&sorm, &format!("colour CTRL -train {path}"));
    assert!(reply.is_ok());
    assert_eq!(reply.reports[0].code, code::DRIFT);
    assert!(
        reply.reports[0]
            .text
            .contains("of the samples of class `a` are taken for it"),
        "{:?}",
        reply.reports
    );
}

#[test]
fn known_colours_that_have_moved_are_told_with_how_far() {
    let sorm = manager();
    let (_samples, samples) = file("samples.csv", SAMPLES.as_bytes());
    let (_watch, watch) = file(
        "watch.csv",
        b"u,v,radius,r,g,b\n20,5,2,120,120,120\n2,5,1,200,60,20\n",
    );
    let (_picture, path) = file("stripes.ppm", &stripes([5, 7, 20, 3]));
    assert!(!ask(&sorm, &format!("colour EXEC watch {path}")).is_ok());
    assert!(
        ask(
            &sorm,
            &format!("colour CTRL -train {samples} -watch {watch}")
        )
        .is_ok()
    );
    let reply = ask(&sorm, &format!("colour EXEC watch {path}"));
    assert!(reply.is_ok(), "{:?}", reply.reports);
    let expected = [
        122.0,
        121.0,
        120.0,
        5.0_f64.sqrt(),
        201.0,
        22.0,
        20.0,
        1445.0_f64.sqrt(),
    ];
    for (found, expected) in reply.floats.iter().zip(expected) {
        assert!((found - expected).abs() < 1e-9, "{:?}", reply.floats);
    }
    assert_eq!(reply.ints, [1]);
    assert_eq!(reply.reports[0].code, code::DRIFT);
    // Counting looks at them, too.
    let counted = ask(&sorm, &format!("colour EXEC {path}"));
    assert!(
        counted.reports[0].text.contains("1 watched colours"),
        "{:?}",
        counted.reports
    );
    assert!(ask(&sorm, "colour CTRL -drift 40").is_ok());
    assert!(
        ask(&sorm, &format!("colour EXEC {path}"))
            .reports
            .is_empty()
    );
    let (_watch, outside) = file("watch.csv", b"u,v,radius,r,g,b\n200,5,2,120,120,120\n");
    assert!(ask(&sorm, &format!("colour CTRL -watch {outside}")).is_ok());
    let (_, text) = refused(&sorm, &format!("colour EXEC {path}"));
    assert!(
        text.contains("200, 5 with radius 2 is not inside"),
        "{text}"
    );
    let (_watch, wrong) = file("watch.csv", b"u,v,radius,r,g,b\n1,5,2,120,300,120\n");
    let (_, text) = refused(&sorm, &format!("colour CTRL -watch {wrong}"));
    assert!(text.contains("2:1"), "{text}");
}

/// A board from above, squares of 40 px, a1 at the lower left, with a border of 30 px; discs by PDN number.
fn board(pieces: &[(usize, char)]) -> Vec<u8> {
    let mut pixels = vec![150_u8; 380 * 380];
    for v in 0..320 {
        for u in 0..320 {
            let (file, row) = (u / 40, v / 40);
            let dark = (file + row) % 2 == 1;
            let number = row * 4 + file / 2 + 1;
            let far = ((u % 40) as f64 - 19.5).hypot((v % 40) as f64 - 19.5);
            let disc = pieces
                .iter()
                .find(|piece| dark && piece.0 == number && far < 15.0);
            pixels[(v + 30) * 380 + u + 30] = match disc {
                Some((_, 'w')) => 240,
                Some((_, 'b')) => 20,
                Some((_, 'W')) => {
                    if far < 6.0 {
                        20
                    } else {
                        240
                    }
                }
                Some(_) => {
                    if far < 6.0 {
                        240
                    } else {
                        20
                    }
                }
                None => {
                    if dark {
                        90
                    } else {
                        200
                    }
                }
            };
        }
    }
    let mut bytes = b"P5 380 380 255\n".to_vec();
    bytes.extend(pixels);
    bytes
}

#[test]
fn board_answers_the_playing_squares_in_the_order_of_pdn() {
    let sorm = manager();
    let (_folder, path) = file(
        "board.pgm",
        &board(&[
            (1, 'b'),
            (4, 'B'),
            (14, 'b'),
            (22, 'w'),
            (29, 'w'),
            (32, 'W'),
        ]),
    );
    let reply = ask(&sorm, &format!("board EXEC TMSG {path}"));
    assert!(reply.is_ok(), "{:?}", reply.reports);
    let mut expected = [0; 32];
    for (number, code) in [(1, 2), (4, 4), (14, 2), (22, 1), (29, 1), (32, 3)] {
        expected[number - 1] = code;
    }
    assert_eq!(reply.ints, expected);
    assert_eq!(reply.floats.len(), 32);
    assert!(
        reply
            .floats
            .iter()
            .all(|confidence| (0.7..=1.0).contains(confidence)),
        "{:?}",
        reply.floats
    );
    // From the other side square 1 is 32, and so on.
    assert!(ask(&sorm, "board CTRL -white top").is_ok());
    let turned = ask(&sorm, &format!("board EXEC TMSG {path}"));
    let reversed: Vec<i64> = expected.iter().rev().copied().collect();
    assert_eq!(turned.ints, reversed);
    assert!(ask(&sorm, "board CTRL -white bottom").is_ok());
    let marker = ask(&sorm, &format!("board EXEC marker {path}"));
    assert_eq!((marker.floats.len(), &marker.ints[..]), (18, &[49][..]));
    let corners = [29.5, 349.5, 349.5, 349.5, 349.5, 29.5, 29.5, 29.5];
    for (found, expected) in marker.floats[9..17].iter().zip(corners) {
        assert!((found - expected).abs() < 0.5, "{:?}", marker.floats);
    }
    // 29 is a1.
    let disk = ask(&sorm, &format!("board EXEC disk {path} FMSG 2 0.4 0.6"));
    assert!(disk.is_ok(), "{:?}", disk.reports);
    assert_eq!(disk.ints, [1]);
    for (found, expected) in disk.floats.iter().zip([49.5, 329.5, 15.0, 0.5, 0.5]) {
        assert!((found - expected).abs() < 0.7, "{:?}", disk.floats);
    }
    let (number, text) = refused(&sorm, &format!("board EXEC disk {path} FMSG 2 4.5 2.5"));
    assert_eq!(number, code::BOARD);
    assert!(text.contains("no disc is seen near 4.50, 2.50"), "{text}");
}

/// The same board in colours, with a disc across squares and a hand over some of them.
fn coloured_board(stray: bool, hand: bool) -> Vec<u8> {
    let grey = board(&[(1, 'b'), (14, 'b'), (22, 'w'), (29, 'w')]);
    let mut bytes = b"P6 380 380 255\n".to_vec();
    for (at, grey) in grey[15..].iter().enumerate() {
        let (u, v) = ((at % 380) as f64, (at / 380) as f64);
        let is_stray = stray && (u - 190.0).hypot(v - 210.0) < 15.0;
        let is_hand = hand && (200.0..300.0).contains(&u) && (60.0..160.0).contains(&v);
        bytes.extend(match grey {
            _ if is_hand => [215, 165, 135],
            _ if is_stray => [140, 25, 20],
            20 => [140, 25, 20],
            90 => [70, 90, 75],
            200 => [150, 140, 120],
            240 => [235, 205, 70],
            _ => [42, 42, 42],
        });
    }
    bytes
}

#[test]
fn what_is_on_light_squares_and_the_picture_read_last_are_told_by_the_same_object() {
    let sorm = manager();
    let (number, text) = refused(&sorm, "board EXEC marker last");
    assert_eq!(number, code::BOARD);
    assert!(text.contains("no board was read yet"), "{text}");
    let (_folder, path) = file("clear.ppm", &coloured_board(false, false));
    let (number, text) = refused(&sorm, &format!("board EXEC rest {path}"));
    assert_eq!(number, code::COLOURS);
    assert!(text.contains("`light`"), "{text}");
    let mut samples = "class,r,g,b\n".to_owned();
    for (class, rgb) in [
        ("white", [235, 205, 70]),
        ("black", [140, 25, 20]),
        ("dark", [70, 90, 75]),
        ("light", [150, 140, 120]),
        ("table", [42, 42, 42]),
    ] {
        for less in [0, 6, 12] {
            let [r, g, b] = rgb.map(|sample| sample - less);
            samples += &format!("{class},{r},{g},{b}\n");
        }
    }
    let (_samples, samples) = file("samples.csv", samples.as_bytes());
    assert!(ask(&sorm, &format!("board CTRL -train {samples}")).is_ok());
    let clear = ask(&sorm, &format!("board EXEC rest {path}"));
    assert_eq!((&clear.floats[..], &clear.ints[..]), (&[0.0][..], &[][..]));
    let marker = ask(&sorm, "board EXEC marker last");
    assert_eq!(marker, ask(&sorm, &format!("board EXEC marker {path}")));
    // 22 is c3.
    let disk = ask(&sorm, "board EXEC disk last FMSG 2 2.5 2.5");
    assert_eq!(disk.ints, [1], "{:?}", disk.reports);

    let (_folder, path) = file("stray.ppm", &coloured_board(true, false));
    let read = ask(&sorm, &format!("board EXEC {path}"));
    assert_eq!(read.ints.iter().filter(|piece| **piece == 2).count(), 2);
    let stray = ask(&sorm, "board EXEC rest last");
    assert_eq!(stray.ints, [2], "{stray:?}");
    assert!(stray.floats[0] < 0.01, "{stray:?}");
    for (found, expected) in stray.floats[1..].iter().zip([4.01, 3.49]) {
        assert!((found - expected).abs() < 0.05, "{stray:?}");
    }

    let (_folder, path) = file("hand.ppm", &coloured_board(false, true));
    let hand = ask(&sorm, &format!("board EXEC rest {path}"));
    assert!((0.05..0.2).contains(&hand.floats[0]), "{hand:?}");
    // What is under it is not known.
    let read = ask(&sorm, "board EXEC last");
    assert!(read.ints.contains(&-1), "{read:?}");
    // A file without a board is not the last picture, and neither is the one before.
    let (_folder, path) = file("stripes.ppm", &stripes([5, 7, 20, 3]));
    refused(&sorm, &format!("board EXEC {path}"));
    let (_, text) = refused(&sorm, "board EXEC last");
    assert!(text.contains("no board was read yet"), "{text}");
}

#[test]
fn a_picture_without_a_board_is_refused_with_the_reason() {
    let sorm = manager();
    let (_folder, path) = file("stripes.ppm", &stripes([5, 7, 20, 3]));
    let (number, text) = refused(&sorm, &format!("board EXEC {path}"));
    assert_eq!(number, code::BOARD);
    assert!(
        text.contains(&path) && text.contains("no chequer pattern is seen: 0 of its 49"),
        "{text}"
    );
    let (_samples, samples) = file("samples.csv", SAMPLES.as_bytes());
    let (_, text) = refused(&sorm, &format!("board CTRL -train {samples}"));
    assert!(text.contains("no class is called `white`"), "{text}");
}

/// A line of light along v = 20, and a box from u = 40 on.
fn lit(light: f64) -> Vec<u8> {
    let grey = |at: usize| {
        let (u, v) = ((at % 80) as f64, (at / 80) as f64);
        let line = light * (-0.5 * ((v - 20.0) / 1.2).powi(2)).exp();
        (20.0 + if u >= 40.0 { 60.0 } else { 0.0 } + line) as u8
    };
    let mut bytes = b"P5 80 60 255\n".to_vec();
    bytes.extend((0..80 * 60).map(grey));
    bytes
}

#[test]
fn lines_answers_lines_of_light_and_edges_with_standard_deviations() {
    let sorm = manager();
    let (_folder, path) = file("lit.pgm", &lit(90.0));
    let (_other, dark) = file("dark.pgm", &lit(0.0));
    ask(&sorm, &format!("lines CTRL -less {dark}"));
    let reply = ask(&sorm, &format!("lines EXEC {path}"));
    assert!(reply.is_ok(), "{:?}", reply.reports);
    assert_eq!((reply.ints[0], reply.floats.len()), (1, 8), "{reply:?}");
    let [u1, v1, u2, v2, sd, sd_direction, ..] = reply.floats[..] else {
        panic!("{reply:?}");
    };
    assert!(
        (v1 - 20.0).abs() < 0.02 && (v2 - 20.0).abs() < 0.02,
        "{reply:?}"
    );
    assert!(u1 < 6.0 && u2 > 73.0, "{reply:?}");
    assert!(
        (1e-4..0.02).contains(&sd) && (1e-6..1e-3).contains(&sd_direction),
        "{reply:?}"
    );
    let points = ask(&sorm, &format!("lines EXEC points {path}"));
    assert_eq!(
        points.floats.len(),
        5 * usize::try_from(points.ints[0]).unwrap()
    );
    assert!(
        points
            .floats
            .chunks(5)
            .all(|point| (point[1] - 20.0).abs() < 0.05)
    );
    // Its edge is between two columns, and the bright side on the right of the way: upwards.
    ask(&sorm, "lines CTRL -less '' -kind edge");
    let edge = ask(&sorm, &format!("lines EXEC {dark}"));
    assert_eq!(edge.ints[0], 1, "{edge:?}");
    let floats = &edge.floats;
    assert!(
        (floats[0] - 39.5).abs() < 0.02 && (floats[2] - 39.5).abs() < 0.02,
        "{edge:?}"
    );
    assert!(floats[1] > floats[3], "{edge:?}");
    // What is not there is a warning, and what cannot be read an error.
    ask(&sorm, "lines CTRL -kind dark");
    let none = ask(&sorm, &format!("lines EXEC {dark}"));
    assert_eq!(
        (none.code, none.reports[0].code),
        (0, code::NO_LINE),
        "{none:?}"
    );
    ask(&sorm, "lines CTRL -less no.png");
    let (number, text) = refused(&sorm, &format!("lines EXEC {path}"));
    assert!(number == code::FILE && text.contains("no.png"), "{text}");
    let (number, _) = refused(&sorm, "lines EXEC camera west");
    assert_eq!(number, code::CAMERA);
}
