use proptest::prelude::*;

use super::*;

const TEXT: &str = include_str!("../../../configs/cell.toml");

fn findings(text: &str) -> Vec<String> {
    match Cell::parse(&Source::new("cell.toml", text)) {
        Ok(_) => Vec::new(),
        Err(findings) => findings
            .into_sorted()
            .iter()
            .map(ToString::to_string)
            .collect(),
    }
}

/// Line and column of the first occurrence of `what` in the shipped file.
fn place(what: &str) -> String {
    let source = Source::new("cell.toml", TEXT);
    let (line, column) = source.line_column(TEXT.find(what).unwrap());
    format!("cell.toml:{line}:{column}")
}

#[test]
fn the_shipped_cell_is_sound() {
    let cell = Cell::parse(&Source::new("cell.toml", TEXT)).unwrap();
    assert_eq!(cell.cameras.len(), 2);
    assert!(cell.camera("ceiling_east").is_ok());
    for camera in &cell.cameras {
        assert!(camera.truth.position().z > 2.8);
    }
    crate::world::World::new(&cell.world()).unwrap();
}

#[test]
fn every_bad_value_is_found_at_once_with_its_place() {
    let text = TEXT
        .replace("radius = 0.012", "radius = nan  ")
        .replace("[0.0, 45.0, -90.0", "[0.0, 45.0, -300.0")
        .replace("read_noise = 13.0\n", "read_noise = -1.0\n");
    let found = findings(&text);
    assert_eq!(found.len(), 4, "{found:?}");
    assert!(found[0].starts_with(&place("[0.0, 45.0")), "{}", found[0]);
    assert!(found[0].contains("joint 3 cannot start at -300 degrees"));
    assert!(found[0].contains("-225 to 45"));
    assert!(found[1].starts_with(&place("0.012")));
    assert!(found[1].contains("NaN"));
    assert!(found[2].contains("read noise is -1"));
}

#[test]
fn an_unknown_key_is_found_with_a_suggestion() {
    let found = findings(&TEXT.replacen("look_at", "lookat ", 1));
    assert!(found[0].starts_with(&place("look_at")), "{}", found[0]);
    assert!(found[0].contains("did you mean `look_at`?"), "{}", found[0]);
}

#[test]
fn a_missing_key_and_a_wrong_type_are_found() {
    let found = findings(&TEXT.replace("fx = 418.6\n", ""));
    assert!(found[0].contains("missing field `fx`"), "{}", found[0]);
    let found = findings(&TEXT.replace("fx = 418.6", "fx = \"x\""));
    assert!(found[0].starts_with(&place("418.6")), "{}", found[0]);
}

#[test]
fn a_lens_that_turns_back_inside_the_picture_is_refused() {
    let found = findings(&TEXT.replace("k1 = -0.151", "k1 = -1.2"));
    assert_eq!(found.len(), 1);
    assert!(found[0].contains("`ceiling_west` turns back inside the picture"));
}

#[test]
fn a_camera_without_a_direction_is_refused() {
    let found = findings(&TEXT.replace(
        "look_at = [0.05, -0.02, 0.8]",
        "look_at = [-0.52, 0.06, 2.91]",
    ));
    assert!(found[0].contains("no definite direction"), "{}", found[0]);
    let found = findings(&TEXT.replace("ceiling_west", "ceiling_east"));
    assert!(found[0].contains("empty or taken"), "{}", found[0]);
}

#[test]
fn an_unknown_camera_is_answered_with_the_nearest_name() {
    let cell = Cell::parse(&Source::new("cell.toml", TEXT)).unwrap();
    let finding = cell.camera("ceiling_est").unwrap_err();
    assert!(finding.to_string().contains("did you mean `ceiling_east`?"));
}

#[test]
fn a_file_that_is_not_there_is_a_finding() {
    let error = Cell::read(Path::new("no/such/cell.toml")).unwrap_err();
    assert!(error.to_string().contains("no/such/cell.toml"));
}

proptest! {
    #[test]
    fn arbitrary_text_never_panics(text in ".{0,200}") {
        let _ = Cell::parse(&Source::new("cell.toml", text));
    }

    #[test]
    fn arbitrary_numbers_never_panic(values in prop::collection::vec(
        prop_oneof![any::<f64>(), -10.0..10.0_f64, Just(0.0)], 30,
    )) {
        let mut values = values.into_iter();
        let text: String = TEXT
            .lines()
            .map(|line| match line.split_once(" = ") {
                Some((key, value)) if value.parse::<f64>().is_ok() => {
                    format!("{key} = {:?}\n", values.next().unwrap_or(1.0)).replace("NaN", "nan")
                }
                _ => format!("{line}\n"),
            })
            .collect();
        let _ = Cell::parse(&Source::new("cell.toml", text));
    }
}
