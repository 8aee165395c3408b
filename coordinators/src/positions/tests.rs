//! What is wrong in a positions file is told where it stands.

use proptest::prelude::*;

use super::*;

const HEADER: &str = "x,y,z,roll,pitch,yaw\n";

fn puma560() -> Model {
    let arm = mcs::model::built_in::model("puma560", mcs::model::file::Inertias::Engine);
    arm.unwrap().unwrap()
}

fn source(text: &str) -> Source {
    Source::new("positions.csv", text)
}

/// Findings as `line:column: message`, in the order of the file.
fn findings(text: &str) -> Vec<String> {
    shown(parse(&source(text)).unwrap_err())
}

fn shown(findings: Findings) -> Vec<String> {
    findings
        .into_sorted()
        .iter()
        .map(|finding| {
            let place = finding.place.as_ref().unwrap().to_string();
            let place = place.strip_prefix("positions.csv:").unwrap().to_owned();
            assert!(finding.help.is_some(), "{finding} says not what to do");
            format!("{place}: {}", finding.message)
        })
        .collect()
}

#[test]
fn a_valid_file_gives_its_poses_and_their_lines() {
    let text = "# lamp\n\nx, y ,z,roll,pitch,yaw\n1,2,3,0,0,90\n# more\n-1e-1,0.5,.25,90,0,0\n";
    let positions = parse(&source(text)).unwrap();
    let lines: Vec<usize> = positions.iter().map(|position| position.line).collect();
    assert_eq!(lines, [4, 6]);
    // A quarter turn about z takes x to y; a quarter turn about x takes y to z.
    let turned = positions[0].pose * Vector3::x();
    assert!((turned - Vector3::y()).norm() < 1e-12);
    let turned = positions[1].pose * Vector3::y();
    assert!((turned - Vector3::z()).norm() < 1e-12);
    let [_, _, _, x, _, _, _, y, _, _, _, z, ..] = positions[1].row_major();
    assert_eq!([x, y, z], [-0.1, 0.5, 0.25]);
}

#[test]
fn windows_line_ends_and_a_byte_order_mark_change_nothing() {
    let text = "# lamp\nx,y,z,roll,pitch,yaw\n1,2,3,0,0,90\n4,5,6,0,0,0\n";
    let windows = format!("\u{feff}{}", text.replace('\n', "\r\n"));
    assert_eq!(
        parse(&source(&windows)).unwrap(),
        parse(&source(text)).unwrap()
    );
}

#[test]
fn a_missing_header_is_told_at_the_first_line_that_counts() {
    let text = "the first line must be the header `x,y,z,roll,pitch,yaw`";
    assert_eq!(findings("# a\n\n1,2,3,4,5,6\n"), [format!("3:1: {text}")]);
    assert_eq!(findings(""), [format!("1:1: {text}")]);
    assert_eq!(findings("# only\n# words\n"), [format!("1:1: {text}")]);
    assert_eq!(findings("x,y,z,yaw,pitch,roll\n"), [format!("1:1: {text}")]);
}

#[test]
fn what_is_no_finite_number_is_shown_at_its_own_column() {
    let text = format!("# a\n{HEADER}1,1,NaN,1,1,1\n\n1,2,3,4, inf ,6\r\n0.1,1,0,ä,0,\n");
    assert_eq!(
        findings(&text),
        [
            "3:5: `NaN` is not a finite number",
            "5:10: `inf` is not a finite number",
            "6:9: `ä` is no number",
            "6:13: a number is missing",
        ]
    );
    // Too large for a number of 64 bits.
    assert_eq!(
        findings(&format!("{HEADER}1,1e999,3,4,5,6")),
        ["2:3: `1e999` is not a finite number"]
    );
}

#[test]
fn a_line_with_too_few_or_too_many_numbers_is_told() {
    let text = format!("{HEADER}1,2,3,4,5\n1,2,3,4,5,6,7\n1,2,3,4,5,6\n");
    assert_eq!(
        findings(&text),
        [
            "2:1: a position has 6 numbers, and here are 5",
            "3:1: a position has 6 numbers, and here are 7",
        ]
    );
}

#[test]
fn a_file_that_is_not_there_is_named() {
    let error = read(Path::new("nowhere/positions.csv"))
        .unwrap_err()
        .to_string();
    assert!(error.contains("nowhere/positions.csv"), "{error}");
}

fn spread(points: impl IntoIterator<Item = [f64; 3]>) -> Vec<String> {
    let mut text = HEADER.to_owned();
    for [x, y, z] in points {
        text += &format!("{x:?},{y:?},{z:?},0,0,0\n");
    }
    let source = source(&text);
    let mut findings = Findings::new();
    check_spread(&parse(&source).unwrap(), &source, &mut findings);
    shown(findings)
}

fn grid(size: usize) -> impl Iterator<Item = [f64; 3]> {
    (0..size).map(|n| [(n % 3) as f64, (n / 3 % 3) as f64, (n / 9) as f64])
}

#[test]
fn eleven_positions_are_too_few_and_twelve_are_not() {
    let few = ["1:1: 11 positions are too few to calibrate a camera: at least 12 are needed"];
    assert_eq!(spread(grid(11)), few);
    assert_eq!(spread(grid(12)), [""; 0]);
}

#[test]
fn positions_at_one_point_on_one_line_or_in_one_plane_are_told() {
    let told = |what| {
        [format!(
            "1:1: all positions lie {what}, which cannot determine a camera"
        )]
    };
    let points = || (0..20).map(|n| (f64::from(n % 5), f64::from(n / 5)));
    for origin in [0.0, 0.7, -3.0, 1e3] {
        let at = |x: f64, y: f64, z: f64| [origin + x, origin + y, origin + z];
        let one_point = spread(points().map(|_| at(0.0, 0.0, 0.0)));
        assert_eq!(one_point, told("at one point"), "at {origin}");
        let one_line = spread(points().map(|(a, _)| at(a, 2.0 * a, -a)));
        assert_eq!(one_line, told("on one line"), "at {origin}");
        let one_plane = spread(points().map(|(a, b)| at(a, b, a + 0.5 * b)));
        assert_eq!(one_plane, told("in one plane"), "at {origin}");
        let space = spread(points().map(|(a, b)| at(a, b, a * b)));
        assert_eq!(space, [""; 0], "at {origin}");
    }
}

#[test]
fn a_pose_out_of_reach_is_told_at_its_line_with_the_reason() {
    // 0.5 m before the shoulder and at its height is well within reach of a 0.86 m arm; 3 m is not.
    let text = format!("{HEADER}0.5,0.1,0.7,0,90,0\n3,0,0.7,0,90,0\n1e300,0,0,0,0,0\n");
    let source = source(&text);
    let positions = parse(&source).unwrap();
    let mut found = Findings::new();
    check_reach(&positions, &source, puma560(), &mut found);
    let found = shown(found);
    assert_eq!(found.len(), 2, "{found:?}");
    assert!(
        found[0].starts_with("3:1: the arm cannot take this pose: "),
        "{found:?}"
    );
    assert!(
        found[1].starts_with("4:1: the arm cannot take this pose: "),
        "{found:?}"
    );
}

proptest! {
    #[test]
    fn any_text_gives_positions_or_findings_and_ends(text in "\\PC*|[-0-9.,einfNa#\r\n \u{feff}]*") {
        for text in [text.clone(), format!("{HEADER}{text}")] {
            let source = source(&text);
            match parse(&source) {
                Ok(positions) => {
                    let mut findings = Findings::new();
                    check_spread(&positions, &source, &mut findings);
                    check_reach(&positions, &source, puma560(), &mut findings);
                }
                Err(findings) => prop_assert!(findings.iter().all(|finding| finding.place.is_some())),
            }
        }
    }

    #[test]
    fn numbers_are_read_as_they_were_written(numbers in prop::collection::vec(-1e6_f64..1e6, 3)) {
        let text = format!("{HEADER}{:?} ,\t{:?},{:?},0,0,0", numbers[0], numbers[1], numbers[2]);
        let position = parse(&source(&text)).unwrap()[0];
        prop_assert_eq!(position.pose.translation.vector.as_slice(), numbers.as_slice());
    }

    #[test]
    fn extreme_coordinates_do_not_stop_the_check(points in prop::collection::vec(prop::array::uniform3(prop::num::f64::NORMAL), 12..20)) {
        spread(points);
    }
}
