//! URDF that is wrong: each mistake has its name and its place, however large the file.

use super::*;
use crate::Solid;
use crate::features::Limits;
use crate::file::Inertias;
use crate::placement::Placement;
use crate::{DynamicsOptions, built_in};

fn read(text: &str) -> Result<FromUrdf, Finding> {
    parse(&Source::new("arm.urdf", text), None, None)
}

/// Two links with a joint of this body between them, a line each.
fn robot(link: &str, joint: &str) -> String {
    format!(
        "<robot name=\"r\">\n<link name=\"a\"/>\n<link name=\"b\">{link}</link>\n\
         <joint name=\"j\" type=\"revolute\"><parent link=\"a\"/><child link=\"b\"/>{joint}</joint>\n</robot>"
    )
}

const LIMIT: &str = "<limit lower=\"-1\" upper=\"1\" effort=\"1\" velocity=\"1\"/>";

fn inertial(mass: &str, inertia: &str) -> String {
    format!("<inertial>{mass}{inertia}</inertial>")
}

#[test]
fn every_mistake_has_a_name_and_a_place() {
    let unit = "<inertia ixx=\"1\" iyy=\"1\" izz=\"1\" ixy=\"0\" ixz=\"0\" iyz=\"0\"/>";
    let not_definite = "<inertia ixx=\"1\" iyy=\"1\" izz=\"1\" ixy=\"2\" ixz=\"0\" iyz=\"0\"/>";
    let one = "<mass value=\"1\"/>";
    let links = |joints: &str| {
        format!(
            "<robot name=\"r\">\n<link name=\"a\"/>\n<link name=\"b\"/>\n<link name=\"c\"/>\n{joints}</robot>"
        )
    };
    let joint = |name: &str, parent: &str, child: &str| {
        format!(
            "<joint name=\"{name}\" type=\"fixed\"><parent link=\"{parent}\"/><child link=\"{child}\"/></joint>\n"
        )
    };
    let cases = [
        (
            "<robot><link name=\"a\"></robot>".to_owned(),
            "malformed XML: ",
            "1:",
        ),
        ("<robot".to_owned(), "malformed XML: ", "1:"),
        (String::new(), "malformed XML: ", "1:1"),
        (
            "<!DOCTYPE a [<!ENTITY b \"c\">]><robot/>".to_owned(),
            "malformed XML: ",
            "1:1",
        ),
        ("<sdf/>".to_owned(), "not a robot: ", "1:1"),
        ("<robot name=\"r\"/>".to_owned(), "no links: ", "1:1"),
        (
            "<robot xmlns:xacro=\"x\">\n<xacro:arm/></robot>".to_owned(),
            "not expanded: ",
            "2:1",
        ),
        (
            "<robot>\n<link/></robot>".to_owned(),
            "missing attribute: ",
            "2:1",
        ),
        (robot("", ""), "no limits: joint `j`", "4:1"),
        (
            robot("", "<limit velocity=\"1\" effort=\"1\"/>"),
            "no limits: the <limit> of joint `j` has neither",
            "4:",
        ),
        (
            robot("", "<limit lower=\"-180\" upper=\"180\"/>"),
            "too far: joint `j` turns from -180 to 180 rad",
            "4:",
        ),
        (
            robot("", "<limit lower=\"-1\" upper=\"1\" velocity=\"0\"/>"),
            "cannot move: the largest velocity of joint `j` is 0",
            "4:",
        ),
        (
            robot("", &format!("{LIMIT}<origin xyz=\"0 431.8 1\"/>")),
            "too far: `xyz` of <origin> has 431.8 m",
            "4:",
        ),
        (
            robot(&inertial("<mass value=\"1 kg\"/>", unit), LIMIT),
            "not a number: `kg` after 1 in `value` of <mass>",
            "3:",
        ),
        (
            robot("", LIMIT).replace("revolute", "screw"),
            "unknown joint type: `screw`",
            "4:23",
        ),
        (
            robot("", LIMIT).replace("revolute", "planar"),
            "unsupported joint type: ",
            "4:23",
        ),
        (
            robot("", &LIMIT.replace("-1", "2")),
            "limits: the lower limit 2",
            "4:",
        ),
        (
            robot("", &LIMIT.replace("-1", "-90deg")),
            "not a number: `-90deg`",
            "4:",
        ),
        (
            robot("", &LIMIT.replace("<limit", "<limit units=\"deg\"")),
            "unknown unit: `deg` in `units` of <limit>",
            "4:",
        ),
        (
            robot("", LIMIT).replace("<robot", "<robot unit=\"inch\""),
            "unknown unit: `inch` in `unit` of <robot>",
            "1:",
        ),
        (
            robot("", &format!("{LIMIT}<axis xyz=\"0 0 0\"/>")),
            "no axis: ",
            "4:14",
        ),
        (
            robot("", &format!("{LIMIT}<axis xyz=\"0 1\"/>")),
            "not a number: 3 are needed, fewer stand",
            "4:",
        ),
        (
            robot("", &format!("{LIMIT}<origin xyz=\"0 nan 1\"/>")),
            "not a number: `nan`",
            "4:",
        ),
        (robot(&inertial("", unit), LIMIT), "missing mass: ", "3:16"),
        (
            robot(&inertial(one, ""), LIMIT),
            "missing inertia: ",
            "3:16",
        ),
        (
            robot(&inertial("<mass/>", unit), LIMIT),
            "missing attribute: <mass> has no `value`",
            "3:26",
        ),
        (
            robot(&inertial("<mass value=\"-1\"/>", unit), LIMIT),
            "negative mass: `b` has -1 kg",
            "3:26",
        ),
        (
            robot(&inertial(one, not_definite), LIMIT),
            "inertia not positive definite: ",
            "3:43",
        ),
        (
            robot(
                &inertial(one, &unit.replace("izz=\"1\"", "izz=\"-1\"")),
                LIMIT,
            ),
            "inertia not positive definite: ",
            "3:43",
        ),
        (
            robot("<collision/>", LIMIT),
            "missing geometry: a <collision> of link `b`",
            "3:16",
        ),
        (
            robot("<collision><geometry><cone/></geometry></collision>", LIMIT),
            "unknown geometry: <cone> of link `b`",
            "3:37",
        ),
        (
            robot(
                "<collision><geometry><sphere radius=\"0\"/></geometry></collision>",
                LIMIT,
            ),
            "no solid: the radius of a solid of `b` is 0 m",
            "3:16",
        ),
        (
            robot("", LIMIT).replace("child link=\"b\"", "child link=\"x\""),
            "unknown link: the child `x`",
            "4:64",
        ),
        (
            robot("", LIMIT).replace("<child link=\"b\"/>", ""),
            "missing child: ",
            "4:1",
        ),
        (
            robot("", LIMIT).replace("name=\"b\"", "name=\"a\""),
            "duplicate name: there is a link `a`",
            "3:13",
        ),
        (
            links(&(joint("j", "a", "b") + &joint("j", "b", "c"))),
            "duplicate name: there is a joint `j`",
            "6:14",
        ),
        (
            links(&joint("j", "a", "b")),
            "two roots: nothing carries link `a`, and nothing link `c`",
            "4:13",
        ),
        (
            links(&(joint("j", "a", "b") + &joint("k", "b", "c") + &joint("l", "a", "c"))),
            "loop: link `c` has two parents",
            "7:14",
        ),
        (
            links(&(joint("j", "a", "b") + &joint("k", "b", "c") + &joint("l", "c", "a"))),
            "loop: every link has a parent",
            "2:13",
        ),
        (
            links(&(joint("k", "b", "c") + &joint("l", "c", "b"))),
            "loop: link `b` is carried by links that it carries",
            "3:13",
        ),
        (
            links(&(joint("j", "a", "b") + &joint("k", "a", "c"))),
            "no tip: several links carry nothing",
            "2:13",
        ),
    ];
    for (text, name, place) in cases {
        let error = read(&text).expect_err(name);
        assert!(
            error.message.starts_with(name),
            "`{}` is not `{name}`: {text}",
            error.message
        );
        let at = error
            .place
            .as_ref()
            .map(ToString::to_string)
            .unwrap_or_default();
        assert!(
            at.starts_with(&format!("arm.urdf:{place}")),
            "{name}: at {at}, not {place}"
        );
    }
}

#[test]
fn a_base_or_tip_that_is_no_link_is_named_with_what_was_probably_meant() {
    let text = robot("", LIMIT);
    for (base, tip) in [(Some("bb"), None), (None, Some("bb"))] {
        let error = parse(&Source::new("arm.urdf", &*text), base, tip).unwrap_err();
        assert!(error.message.starts_with("unknown link: the "), "{error}");
        assert_eq!(error.help.as_deref(), Some("did you mean `b`?"));
    }
}

#[test]
fn forms_for_collisions_are_read_and_a_mesh_is_told_of() {
    let collision = |form: &str| {
        format!(
            "<collision><origin xyz=\"0 0 0.1\" rpy=\"0 1.5707963267948966 0\"/><geometry>{form}</geometry></collision>"
        )
    };
    let forms = [
        "<box size=\"0.1 0.2 0.3\"/>",
        "<sphere radius=\"0.05\"/>",
        "<cylinder radius=\"0.1\" length=\"0.6\"/>",
        "<cylinder radius=\"0.3\" length=\"0.1\"/>",
        "<mesh filename=\"package://r/b.stl\"/>",
    ];
    let all = forms.map(collision).concat();
    let about_z = format!("{LIMIT}<axis xyz=\"0 0 1\"/>");
    let read = read(&robot(&all, &about_z)).unwrap();
    let [first, second, third, fourth] = read.model.shapes() else {
        panic!("{:?}", read.model.shapes());
    };
    assert!(matches!(first.solid, Solid::Block { half, .. } if (half.x - 0.05).abs() < 1e-12));
    assert_eq!(
        second.solid,
        Solid::sphere(nalgebra::Vector3::new(0.0, 0.0, 0.1), 0.05)
    );
    // Lies along x of its link.
    assert!(
        matches!(third.solid, Solid::Capsule { a, b, radius } if radius == 0.1
            && (b - a - nalgebra::Vector3::new(0.6, 0.0, 0.0)).norm() < 1e-12),
        "{third:?}"
    );
    assert!(matches!(fourth.solid, Solid::Block { half, .. } if (half.z - 0.05).abs() < 1e-12));
    let told: Vec<String> = read.warnings.iter().map(ToString::to_string).collect();
    assert!(
        told.iter()
            .any(|text| text.contains("the meshes of b for collisions are not read")),
        "{told:?}"
    );
}

/// A chain of links with joints of this type.
fn chain(links: usize, kind: &str) -> String {
    let mut text = "<robot name=\"long\">\n<link name=\"l0\"/>\n".to_owned();
    for index in 1..links {
        text += &format!(
            "<link name=\"l{index}\"/>\n<joint name=\"j{index}\" type=\"{kind}\"><origin xyz=\"0 0 0.001\"/>\
             <parent link=\"l{}\"/><child link=\"l{index}\"/></joint>\n",
            index - 1
        );
    }
    text + "</robot>"
}

#[test]
fn ten_thousand_links_are_read_at_once_or_refused_for_their_number() {
    let many = read(&chain(10_000, "continuous")).unwrap_err();
    assert!(
        many.message.starts_with("too many joints: joint `j65`"),
        "{many}"
    );
    let fixed = read(&chain(10_000, "fixed")).unwrap().model;
    let tip = fixed.at(fixed.tip()).placement.origin;
    assert_eq!(fixed.dof(), 0);
    assert!((tip.z - 9.999).abs() < 1e-9, "{tip}");
    let source = Source::new("long.urdf", chain(10_000, "continuous"));
    let some = parse(&source, Some("l5000"), Some("l5010")).unwrap().model;
    assert_eq!(some.dof(), 10);
    let deep = "<a>".repeat(100_000);
    assert!(read(&format!("<robot name=\"r\">{deep}")).is_err());
    let wide: String = (0..100_000)
        .map(|index| format!(" a{index}=\"\""))
        .collect();
    let wide = read(&format!("<robot{wide}/>")).unwrap_err();
    assert!(wide.message.contains("more than 256 attributes"), "{wide}");
}

#[test]
fn a_way_up_the_tree_is_the_way_down_backwards() {
    let file = include_str!("../../../tests/known_answers/two_arms.urdf");
    let source = Source::new("two_arms.urdf", file);
    let ends = ["left_hand", "right_hand"];
    let there = parse(&source, Some(ends[0]), Some(ends[1])).unwrap().model;
    let back = parse(&source, Some(ends[1]), Some(ends[0])).unwrap().model;
    let q = [0.3, -0.5, 0.7, 0.2, 0.1, -0.4];
    let mut other = q;
    other.reverse();
    let names = |model: &Model| -> Vec<String> {
        model
            .joints()
            .iter()
            .map(|joint| joint.name.clone())
            .collect()
    };
    let mut reversed = names(&back);
    reversed.reverse();
    assert_eq!(names(&there), reversed);
    let way = there.placement(&mut there.data(), &q, there.tip());
    let way_back = back.placement(&mut back.data(), &other, back.tip());
    let none = way.then(&way_back);
    assert!(
        none.origin.norm() < 1e-12
            && (none.rotation - nalgebra::Matrix3::identity()).norm() < 1e-12
    );
}

/// A model as it is read back from what is written of it.
fn written(model: &Model, tip: Option<&str>) -> Model {
    let text = write(model);
    let source = Source::new("written.urdf", text.as_str());
    let found = parse(&source, None, tip);
    found
        .unwrap_or_else(|finding| panic!("{finding}\n{text}"))
        .model
}

#[test]
fn a_model_that_is_written_and_read_again_moves_as_before() {
    let q = [0.3, -0.5, 0.7, -1.2, 0.1, -0.4, 0.9, 0.2, -0.8];
    for name in ["puma560", "puma600", "transporter", "testbed9"] {
        for inertias in [Inertias::Identified, Inertias::Engine] {
            let model = built_in::model(name, inertias).unwrap().unwrap();
            let again = written(&model, Some(&model.at(model.tip()).name));
            let (mut data, mut others) = (model.data(), again.data());
            assert_eq!((again.name(), again.dof()), (name, model.dof()));
            let (q, qd, qdd) = (&q[..model.dof()], &q[9 - model.dof()..], &q[..model.dof()]);
            let here = model.placement(&mut data, q, model.tip());
            let there = again.placement(&mut others, q, again.tip());
            assert!((here.origin - there.origin).amax() < 1e-12, "{name}");
            assert!((here.rotation - there.rotation).amax() < 1e-12, "{name}");
            // Without friction: the mean of both directions is written.
            let options = DynamicsOptions::WITH_ROTORS;
            let torques = model
                .inverse_dynamics(&mut data, q, qd, qdd, options)
                .to_vec();
            let found = again.inverse_dynamics(&mut others, q, qd, qdd, options);
            for (torque, found) in torques.iter().zip(found) {
                assert!((torque - found).abs() < 1e-10, "{name}: {torque} {found}");
            }
            // Readers of others ask for both wherever there is a limit.
            for limit in write(&model).lines().filter(|line| line.contains("<limit")) {
                let both = limit.contains(" velocity=") && limit.contains(" effort=");
                assert!(both, "{name}: {limit}");
            }
            for (one, other) in model.joints().iter().zip(again.joints()) {
                let limits = |joint: &crate::Joint| {
                    let Limits {
                        lower,
                        upper,
                        velocity,
                        torque,
                        ..
                    } = joint.limits;
                    (
                        joint.name.clone(),
                        joint.kind,
                        [lower, upper, velocity, torque],
                    )
                };
                assert_eq!(limits(one), limits(other));
                let rub = |joint: &crate::Joint| {
                    joint.motor.friction_torque(1.0) - joint.motor.friction_torque(-1.0)
                };
                assert!(
                    (rub(one) - rub(other)).abs() <= 1e-12 * rub(one).abs(),
                    "{name}"
                );
            }
        }
    }
}

#[test]
fn the_form_of_a_model_that_is_written_and_read_again_stands_where_it_stood() {
    let mut boxed = ModelBuilder::new("boxed", "base");
    let base = boxed.base();
    let at = Placement::from_degrees([0.1, -0.2, 0.3], [10.0, 20.0, 30.0]);
    let half = nalgebra::Vector3::new(0.1, 0.2, 0.3);
    boxed.shape(base, &Solid::Block { at, half }).unwrap();
    let spec = JointSpec {
        before: at,
        axis: nalgebra::Vector3::new(0.3, 0.4, -0.5),
        after: at.inverse(),
        ..JointSpec::new("joint", JointKind::Revolute, base)
    };
    let link = boxed.joint(spec, "link").unwrap();
    boxed.shape(link, &Solid::Block { at, half }).unwrap();
    let on_it = boxed.frame("on_it", link, &at).unwrap();
    boxed.shape(on_it, &Solid::sphere(half, 0.05)).unwrap();
    let built_in = ["puma560", "puma600", "testbed9"]
        .map(|name| built_in::model(name, Inertias::Engine).unwrap().unwrap());
    for model in built_in.into_iter().chain([boxed.build()]) {
        let again = written(&model, Some(&model.at(model.tip()).name));
        let q: Vec<f64> = (0..model.dof())
            .map(|joint| 0.3 * joint as f64 - 0.7)
            .collect();
        let stands = |model: &Model| {
            let mut data = model.data();
            model.forward(&mut data, &q);
            let shapes = model.shapes().iter();
            let mut all: Vec<(Option<usize>, [nalgebra::Vector3<f64>; 2])> = shapes
                .map(|shape| {
                    let solid = shape.solid.seen_from(&data.carrier(shape.carrier));
                    let ends = match solid {
                        Solid::Capsule { a, b, radius } => [a, b + half * radius],
                        Solid::Block { at, half } => [at.point(&half), at.origin],
                        Solid::Hull { at, .. } => [at.origin; 2],
                    };
                    (shape.carrier, ends)
                })
                .collect();
            all.sort_by_key(|(carrier, _)| *carrier);
            all
        };
        let (before, after) = (stands(&model), stands(&again));
        assert!(!before.is_empty());
        assert_eq!(before.len(), after.len(), "{}", model.name());
        for ((carrier, before), (found, after)) in before.iter().zip(&after) {
            assert_eq!(carrier, found);
            for (before, after) in before.iter().zip(after) {
                assert!((before - after).norm() < 1e-12, "{before} {after}");
            }
        }
    }
}

#[test]
fn a_tree_that_is_written_has_all_its_arms() {
    let model = built_in::model("testbed18", Inertias::Engine)
        .unwrap()
        .unwrap();
    for tip in ["left_arm.link6", "right_arm.link6"] {
        let frame = model.frame(tip).unwrap_or_else(|| {
            panic!(
                "{:?}",
                model.frames().iter().map(|f| &f.name).collect::<Vec<_>>()
            )
        });
        let arm = written(&model, Some(tip));
        let q: Vec<f64> = (0..18).map(|index| 0.1 * f64::from(index) - 0.7).collect();
        let own: Vec<f64> = model.chain(frame).iter().map(|joint| q[*joint]).collect();
        let here = model.placement(&mut model.data(), &q, frame);
        let there = arm.placement(&mut arm.data(), &own, arm.tip());
        assert_eq!(arm.dof(), 9);
        assert!((here.origin - there.origin).amax() < 1e-12, "{tip}");
        assert!((here.rotation - there.rotation).amax() < 1e-12, "{tip}");
    }
}

#[test]
fn a_rotor_that_cannot_be_is_refused_at_its_place() {
    let model = built_in::model("puma560", Inertias::Engine)
        .unwrap()
        .unwrap();
    let text = write(&model);
    for (from, to, why) in [
        (
            "<rotorInertia>0.0002<",
            "<rotorInertia>-1<",
            "negative inertia: ",
        ),
        (
            "<rotorInertia>0.0002<",
            "<rotorInertia>heavy<",
            "not a finite number: ",
        ),
        (
            "<mechanicalReduction>-62.6111<",
            "<mechanicalReduction>0<",
            "no gear: ",
        ),
        (
            "    <joint name=\"joint1\"/>",
            "    <joint name=\"join1\"/>",
            "unknown joint: ",
        ),
    ] {
        let changed = text.replacen(from, to, 1);
        assert_ne!(changed, text, "{from}");
        let finding = parse(&Source::new("arm.urdf", changed), None, None).unwrap_err();
        assert!(finding.message.starts_with(why), "{finding}");
        assert!(finding.place.is_some(), "{finding}");
    }
}

#[test]
fn a_name_with_letters_that_xml_keeps_for_itself_comes_back_as_it_was() {
    let mut builder = ModelBuilder::new("a <b> & \"c\"", "base");
    let base = builder.base();
    let spec = JointSpec::new("j<1>", JointKind::Prismatic, base);
    builder.joint(spec, "l&1").unwrap();
    let again = written(&builder.build(), None);
    assert_eq!(
        (again.name(), again.joints()[0].name.as_str()),
        ("a <b> & \"c\"", "j<1>")
    );
}

proptest::proptest! {
    #[test]
    fn any_turn_is_written_so_that_it_is_read_again(roll in -3.2..3.2_f64, pitch in -3.2..3.2_f64, yaw in -3.2..3.2_f64, upright in -4..5_i32) {
        // Also near the poles of roll, pitch and yaw, and on them.
        let quarter = f64::from(upright) * std::f64::consts::FRAC_PI_2;
        for pitch in [pitch, quarter, quarter + 1e-9 * pitch, quarter + 1e-5 * pitch] {
            let placement = Placement::from_radians([0.1, 0.2, 0.3], [roll, pitch, yaw]);
            let mut builder = ModelBuilder::new("turned", "base");
            let base = builder.base();
            builder.frame("frame", base, &placement).unwrap();
            let again = written(&builder.build(), None);
            let found = again.placement(&mut again.data(), &[], again.tip());
            proptest::prop_assert!((found.rotation - placement.rotation).amax() < 1e-14, "{pitch}");
        }
    }

    #[test]
    fn a_file_cut_or_changed_anywhere_is_read_or_refused(at in 0..7000_usize, byte in 0..128_u8, cut in proptest::prelude::any::<bool>()) {
        let mut text = include_str!("../../../tests/known_answers/two_arms.urdf").to_owned();
        let at = at % text.len();
        if cut {
            text.truncate(at);
        } else {
            text.replace_range(at..=at, &char::from(byte).to_string());
        }
        let source = Source::new("changed.urdf", text);
        if let Err(finding) = parse(&source, None, Some("left_hand")) {
            proptest::prop_assert!(finding.place.is_some(), "{}", finding);
        }
    }
}
