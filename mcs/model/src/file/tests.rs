//! Model files that are wrong: each mistake at its place.

use super::*;

fn read(text: &str) -> Result<Model, Findings> {
    parse(&Source::new("arm.toml", text), Inertias::Identified)
}

#[test]
fn every_mistake_has_its_place() {
    let joint = "name = \"arm\"\n[[joint]]\nname = \"a\"\ntype = \"revolute\"\n";
    let cases = [
        ("name = ".to_owned(), "1:", ""),
        (
            "name = \"arm\"\nnme = 1".to_owned(),
            "2:1",
            "unknown key `nme`",
        ),
        (
            "[[joint]]\nname = \"a\"\ntype = \"revolute\"".to_owned(),
            "",
            "name",
        ),
        (joint.replace("revolute", "ball"), "4:8", "ball"),
        (
            format!("{joint}dh = {{ alpha = 90 }}\naxis = [0, 0, 1]"),
            "2:1",
            "has `dh` and `at` or `axis`",
        ),
        (format!("{joint}axis = [0, 0, 0]"), "2:1", "no axis: "),
        (
            format!("{joint}limits = {{ range = [1, -1] }}"),
            "2:1",
            "limits: the lower limit",
        ),
        (
            format!("{joint}limits = {{ torque = -1 }}"),
            "2:1",
            "limits: the largest torque",
        ),
        (
            format!("{joint}body = {{ mass = -1, inertia = [1, 1, 1] }}"),
            "5:1",
            "negative mass: ",
        ),
        (
            format!("{joint}body = {{ mass = 1, inertia = [1, 1] }}"),
            "5:30",
            "an inertia has 3 numbers",
        ),
        (
            format!("{joint}body = {{ mass = 1, inertia = [1, 1, -1] }}"),
            "5:1",
            "inertia not positive definite: ",
        ),
        (
            format!("{joint}body = {{ mass = nan, inertia = [1, 1, 1] }}"),
            "5:1",
            "not a finite number: ",
        ),
        (
            format!(
                "{joint}shapes = [{{ sphere = [0, 0, 0], radius = 1 }}, {{ box = [1, 1, 0] }}]"
            ),
            "5:47",
            "no solid: the edge of a solid of `a` is 0 m",
        ),
        (
            format!("{joint}shapes = [{{ capsule = [[0, 0, 0], [0, 0, 1]] }}]"),
            "5:11",
            "a capsule and a sphere have a `radius`",
        ),
        (
            format!("{joint}shapes = [{{ sphere = [0, 0, 0], box = [1, 1, 1], radius = 1 }}]"),
            "5:11",
            "a solid is either",
        ),
        (
            "name = \"arm\"\nshapes = [{ sphere = [0, 0, nan], radius = 1 }]".to_owned(),
            "2:11",
            "not a finite number: a solid of `base`",
        ),
        (
            format!("{joint}parent = \"b\""),
            "5:10",
            "there is no frame `b`",
        ),
        (
            format!("{joint}[[joint]]\nname = \"a\"\nlink = \"c\"\ntype = \"revolute\""),
            "5:1",
            "duplicate name: ",
        ),
        (
            "name = \"arm\"\ntip = \"x\"".to_owned(),
            "2:7",
            "there is no frame `x`",
        ),
        (
            "name = \"arm\"\n[[part]]\nname = \"p\"\nmodel = \"puma56\"".to_owned(),
            "4:9",
            "there is no model `puma56`",
        ),
    ];
    for (text, place, message) in cases {
        let findings = read(&text).expect_err(&text);
        let finding = findings.iter().next().unwrap().to_string();
        assert!(
            finding.starts_with(&format!("arm.toml:{place}")),
            "{finding}: not at {place} of\n{text}"
        );
        assert!(finding.contains(message), "{finding}: not `{message}`");
    }
}

#[test]
fn a_model_that_is_a_part_of_itself_is_refused() {
    let folder = std::env::temp_dir().join(format!("mcs-models-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("snake.toml");
    std::fs::write(
        &path,
        "name = \"snake\"\n[[part]]\nname = \"tail\"\nmodel = \"snake\"\n",
    )
    .unwrap();
    let findings = super::read(&path, Inertias::Identified)
        .unwrap_err()
        .to_string();
    std::fs::remove_dir_all(&folder).unwrap();
    assert!(
        findings.contains("snake.toml:2:1: error: loop: "),
        "{findings}"
    );
}

#[test]
fn joints_given_by_dh_rows_and_by_places_and_axes_are_the_same_arm() {
    let by_rows = read(
        "name = \"a\"\n[[joint]]\nname = \"1\"\ntype = \"revolute\"\ndh = { theta = 30, d = 0.5, a = 0.2, alpha = 90 }\n\
         [[joint]]\nname = \"2\"\ntype = \"prismatic\"\ndh = { d = 0.1, alpha = -90 }\n",
    );
    let by_places = read(
        "name = \"a\"\n[[joint]]\nname = \"1\"\ntype = \"revolute\"\nat = { rpy = [0, 0, 30] }\naxis = [0, 0, 3]\n\
         [[joint]]\nname = \"2\"\ntype = \"prismatic\"\nat = { xyz = [0.2, -0.1, 0.5] }\naxis = [0, -1, 0]\n",
    );
    let (by_rows, by_places) = (by_rows.unwrap(), by_places.unwrap());
    let q = [0.7, 0.3];
    let one = by_rows.placement(&mut by_rows.data(), &q, by_rows.tip());
    let other = by_places.placement(&mut by_places.data(), &q, by_places.tip());
    assert!(
        (one.origin - other.origin).norm() < 1e-12,
        "{} {}",
        one.origin,
        other.origin
    );
}

#[test]
fn the_outer_form_of_a_part_goes_with_it_wherever_it_is_put() {
    let model = |name| {
        let text = built_in::source(name).unwrap();
        parse(&text, Inertias::Identified).unwrap()
    };
    let (alone, both) = (model("puma560"), model("testbed18"));
    assert_eq!(alone.shapes().len(), 9);
    assert_eq!(both.shapes().len(), 2 * (9 + 3));
    let q = [0.3, -0.4, 0.2, 0.5, 0.8, -1.2, 0.4, 0.9, -0.6];
    let mut data = both.data();
    both.forward(&mut data, &q.repeat(2));
    let mut own = alone.data();
    alone.forward(&mut own, &q[3..]);
    for (cart, arm) in [("left_cart", "left_arm"), ("right_cart", "right_arm")] {
        let mount = both.frame(&format!("{cart}.mount")).unwrap();
        let mount = data.placement(&both, mount);
        for shape in alone.shapes() {
            let name = &alone.at(shape.frame).name;
            let seen = shape.solid.seen_from(&own.carrier(shape.carrier));
            let expected = seen.seen_from(&mount).ball();
            let found = both.shapes().iter().any(|part| {
                let ball = part.solid.seen_from(&data.carrier(part.carrier)).ball();
                both.at(part.frame).name == format!("{arm}.{name}")
                    && (ball.0 - expected.0).norm() < 1e-12
            });
            assert!(found, "{arm}.{name}");
        }
    }
    let moved = alone.clone().moved(&Placement::shifted(0.0, 0.0, 0.5));
    let base = |model: &Model| model.shapes()[0].solid.ball().0.z;
    assert!((base(&moved) - base(&alone) - 0.5).abs() < 1e-12);
}
