use proptest::prelude::*;

use super::*;

const TEXT: &str = include_str!("../../../../configs/cell.toml");

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
    place_in(TEXT, what)
}

fn place_in(text: &str, what: &str) -> String {
    let source = Source::new("cell.toml", text);
    let (line, column) = source.line_column(text.find(what).unwrap());
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
    assert_eq!(crate::world::World::new(&cell).arms(), 1);
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

#[test]
fn an_unknown_model_arm_or_link_is_found_at_its_name_with_the_nearest() {
    for (from, to, meant) in [
        ("model = \"puma560\"", "model = \"puma650\"", "puma560"),
        ("arm = \"puma\"", "arm = \"pume\"", "puma"),
        ("link = \"link6\"", "link = \"lnik6\"", "link6"),
    ] {
        let text = TEXT.replacen(from, to, 1);
        let found = findings(&text);
        let [one] = &found[..] else {
            panic!("{found:#?}");
        };
        let value = to.split_once("= ").unwrap().1;
        assert!(one.starts_with(&place_in(&text, value)), "{one}");
        assert!(one.contains(&format!("did you mean `{meant}`?")), "{one}");
    }
}

#[test]
fn a_start_with_a_wrong_number_of_joints_says_how_many_there_are() {
    let found = findings(&TEXT.replace("start = [0.0, 45.0, ", "start = [45.0, "));
    assert_eq!(found.len(), 1, "{found:#?}");
    assert!(
        found[0].contains("5 joints start, and model `puma560` has 6"),
        "{}",
        found[0]
    );
}

#[test]
fn two_arms_of_one_name_are_refused() {
    let arm = "[[arm]]\nname = \"puma\"\nmodel = \"puma560\"\nstart = [0, 0, 0, 0, 0, 0]\n";
    let text = format!("{arm}{arm}");
    let found = findings(&text);
    assert!(found[0].starts_with("cell.toml:6:8: "), "{found:#?}");
    assert!(
        found[0].contains("an arm cannot be called `puma`"),
        "{found:#?}"
    );
}

const BALL: &str = "[[object]]\nname = \"ball\"\nshape = \"sphere\"\nradius = 0.1\nmass = 1.0\ngrey = 90\nposition = ";

#[test]
fn an_object_that_starts_in_something_is_refused_and_both_are_named() {
    let other = BALL.replace("ball", "other");
    for (more, what) in [
        (format!("{BALL}[0.0, 0.0, 0.3]\n"), "in `puma.base`"),
        (
            format!("{BALL}[0.1, 1.5, 0.36]\n"),
            "in a piece of furniture",
        ),
        (format!("{BALL}[1.0, 0.0, 0.09]\n"), "in the floor"),
        (
            format!("{other}[1.0, 0.0, 0.1]\n{BALL}[1.1, 0.1, 0.1]\n"),
            "in `other`",
        ),
    ] {
        let text = format!("{TEXT}\n{more}");
        let found = findings(&text);
        let [one] = &found[..] else {
            panic!("{what}: {found:#?}");
        };
        assert!(
            one.contains("object `ball` starts") && one.contains(what),
            "{one}"
        );
        let at = more.rsplit("position = ").next().unwrap().trim();
        assert!(one.starts_with(&place_in(&text, at)), "{one}");
    }
    // One on the other, on the floor.
    let stack = format!("{TEXT}\n{other}[1.0, 0.0, 0.1]\n{BALL}[1.0, 0.0, 0.3]\n");
    assert_eq!(findings(&stack), [""; 0]);
}

#[test]
fn an_object_needs_what_its_form_is_made_of() {
    let text = |form: &str| format!("{}[1.0, 0.0, 1.0]\n", BALL.replace("sphere", form));
    assert!(findings(&text("cylinder"))[0].contains("has no height"));
    assert!(findings(&text("box"))[0].contains("has no size"));
    assert!(findings(&text("cube"))[0].contains("unknown variant"));
}

#[test]
fn a_camera_on_a_wrist_looks_from_where_the_wrist_is() {
    let camera = TEXT[TEXT.find("[[camera]]").unwrap()..]
        .replacen(
            "name = \"ceiling_west\"",
            "name = \"wrist\"\narm = \"puma\"\nlink = \"link6\"",
            1,
        )
        .replacen(
            "position = [-0.52, 0.06, 2.91]",
            "position = [0.05, 0.0, 0.0]",
            1,
        )
        .replacen(
            "look_at = [0.05, -0.02, 0.8]",
            "look_at = [0.05, 0.0, 1.0]",
            1,
        );
    let text = format!("{}{camera}", &TEXT[..TEXT.find("[[camera]]").unwrap()]);
    let cell = Cell::parse(&Source::new("cell.toml", text)).unwrap();
    let joints = [0.3, 0.5, -1.2, 0.2, 0.7, 0.1];
    let scene = cell.scene(&[&joints]);
    let wrist = scene.body("puma.link6").unwrap().pose;
    let seen = cell.camera("wrist").unwrap().at(&scene);
    assert!((seen.position() - wrist * Point3::new(0.05, 0.0, 0.0)).norm() < 1e-9);
    let ahead = seen.camera_t_world * (wrist * Point3::new(0.05, 0.0, 1.0));
    assert!((ahead - Point3::new(0.0, 0.0, 1.0)).norm() < 1e-9);
}

#[test]
fn a_false_tip_moves_what_the_tip_carries() {
    let text = TEXT.replacen(
        "friction = false",
        "friction = false\ntip_offset = [0.0, 0.0, 0.01]",
        1,
    );
    let [truth, model] = [text.as_str(), TEXT].map(|text| {
        let cell = Cell::parse(&Source::new("cell.toml", text)).unwrap();
        cell.start().lamps[0].centre
    });
    assert!(((truth - model).norm() - 0.01).abs() < 1e-12);
}

proptest! {
    #[test]
    fn arbitrary_text_never_panics(text in ".{0,200}") {
        let _ = Cell::parse(&Source::new("cell.toml", text));
    }

    #[test]
    fn arbitrary_numbers_never_panic(values in prop::collection::vec(
        prop_oneof![any::<f64>(), -10.0..10.0_f64, Just(0.0)], 40,
    )) {
        let mut values = values.into_iter();
        let more = format!("{BALL}[1.0, 0.0, 1.0]\n");
        let text: String = TEXT
            .lines()
            .chain(more.lines())
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

#[test]
fn a_sensor_that_cannot_be_is_found_at_its_place() {
    let sensor = "\n[[force_torque]]\nname = 'wrist'\narm = 'puma'\n";
    for (from, to, why) in [
        ("arm = 'puma'", "arm = 'pume'", "did you mean `puma`?"),
        (
            "name = 'wrist'",
            "name = ''",
            "a sensor cannot be called ``",
        ),
        (
            "name",
            "load = { mass = -1, centre = [0, 0, 0] }\nname",
            "the mass behind a sensor is -1",
        ),
        (
            "name",
            "noise = [nan, 0]\nname",
            "the noise of a sensor is [NaN, 0.0]",
        ),
        (
            "name",
            "filter_hz = 0\nname",
            "the filter of a sensor is 0 Hz",
        ),
        ("name", "corner = 3\nname", "unknown field `corner`"),
    ] {
        let text = format!("{TEXT}{}", sensor.replacen(from, to, 1));
        let found = findings(&text);
        assert_eq!(found.len(), 1, "{found:?}");
        assert!(found[0].starts_with("cell.toml:"), "{}", found[0]);
        assert!(found[0].contains(why), "{}", found[0]);
    }
    assert!(findings(&format!("{TEXT}{sensor}")).is_empty());
}

#[test]
fn a_scanner_in_the_room_needs_mirrors_and_a_pointer_on_an_arm_does_not() {
    let laser = "\n[[laser]]\nname = \"line\"\nposition = [0.0, 0.0, 2.0]\nlook_at = [0.0, 0.0, 1.0]\nup = [1.0, 0.0, 0.0]\nradius = 0.003\nbrightness = 200.0\n";
    let found = findings(&format!("{TEXT}{laser}"));
    let [one] = &found[..] else {
        panic!("{found:#?}");
    };
    assert!(one.contains("lacks `gain` or `mirror_offset`"), "{one}");
    let mirrors = "gain = [10.0, 10.0]\nmirror_offset = 0.01\n";
    assert_eq!(findings(&format!("{TEXT}{laser}{mirrors}")), [""; 0]);
    let carried = "arm = \"puma\"\nlink = \"flange\"\n";
    assert_eq!(findings(&format!("{TEXT}{laser}{carried}")), [""; 0]);
}
