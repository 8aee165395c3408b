//! The classes `kin` and `dyn` for arms other than the PUMA 560: what is built in, models from files, ways through URDF.

use super::*;
use std::path::PathBuf;

/// A file that is gone when the test is over.
struct Scratch(PathBuf);

impl Scratch {
    fn new(name: &str, text: &str) -> Self {
        let path = std::env::temp_dir().join(format!("mcs-{}-{name}", std::process::id()));
        std::fs::write(&path, text).unwrap();
        Self(path)
    }

    fn path(&self) -> std::path::Display<'_> {
        self.0.display()
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

const BUILT_IN: [(&str, usize); 5] = [
    ("puma560", 6),
    ("puma600", 6),
    ("transporter", 3),
    ("testbed9", 9),
    ("testbed18", 18),
];

#[test]
fn every_arm_answers_as_many_numbers_as_it_has_joints() {
    let sorm = manager();
    for (arm, n) in BUILT_IN {
        let q = vec![0.1; n];
        assert_eq!(
            floats(&sorm, &format!("kin.{arm} EXEC TMSG fkine"), &q).len(),
            16
        );
        assert_eq!(
            floats(&sorm, &format!("kin.{arm} EXEC TMSG jacobian"), &q).len(),
            6 * n
        );
        assert_eq!(
            floats(&sorm, &format!("dyn.{arm} EXEC TMSG gravity"), &q).len(),
            n
        );
        assert_eq!(
            floats(&sorm, &format!("dyn.{arm} EXEC TMSG inertia"), &q).len(),
            n * n
        );
        let state = vec![0.1; 3 * n];
        assert_eq!(
            floats(&sorm, &format!("dyn.{arm} EXEC TMSG rne"), &state).len(),
            n
        );
        assert_eq!(
            floats(&sorm, &format!("dyn.{arm} EXEC TMSG fdyn"), &state).len(),
            n
        );
        let wrong = compute(
            &sorm,
            &format!("kin.{arm} EXEC TMSG fkine"),
            &vec![0.0; n + 1],
        );
        let text = &wrong.reports.last().unwrap().text;
        assert!(
            !wrong.is_ok() && text.contains(&format!("takes {n} floats")),
            "{text}"
        );
    }
}

#[test]
fn the_testbed_stands_in_the_world_as_stated() {
    let sorm = manager();
    for arm in ["testbed9", "testbed18"] {
        let at_zero = floats(
            &sorm,
            &format!("kin.{arm} EXEC TMSG fkine"),
            &vec![0.0; if arm == "testbed9" { 9 } else { 18 }],
        );
        #[rustfmt::skip]
        let expected = [
            1.0, 0.0, 0.0, 0.4521,
            0.0, 1.0, 0.0, -0.15005,
            0.0, 0.0, 1.0, 1.60363,
            0.0, 0.0, 0.0, 1.0,
        ];
        near(&at_zero, &expected, 1e-12);
    }
    assert!(ask(&sorm, "kin.testbed18 CTRL -tip right").is_ok());
    let right = floats(&sorm, "kin.testbed18 EXEC TMSG fkine", &[0.0; 18]);
    near(
        &[right[3], right[7], right[11]],
        &[0.4521, 1.2 - 0.15005, 1.60363],
        1e-12,
    );
    // The track leads along the world's x.
    let mut q = [0.0; 18];
    q[9] = 1.5;
    let moved = floats(&sorm, "kin.testbed18 EXEC TMSG fkine", &q);
    assert!((moved[3] - right[3] - 1.5).abs() < 1e-12);
    let jacobian = floats(&sorm, "kin.testbed18 EXEC TMSG jacobian", &[0.2; 18]);
    for row in jacobian.chunks(18) {
        assert!(
            row[..9].iter().all(|number| *number == 0.0),
            "the left arm moves the right tip"
        );
    }
    let (code, text) = refused(&sorm, "kin.testbed18 CTRL -tip middle");
    assert_eq!(code, code::MODEL);
    assert!(
        text.contains("no frame `middle`") && text.contains("left, right"),
        "{text}"
    );
    // What was refused changed nothing.
    assert_eq!(floats(&sorm, "kin.testbed18 EXEC TMSG fkine", &q), moved);
}

#[test]
fn the_puma_600_stands_on_its_own_pedestal() {
    let sorm = manager();
    let at_zero = floats(&sorm, "kin.puma600 EXEC TMSG fkine", &[0.0; 6]);
    near(
        &[at_zero[3], at_zero[7], at_zero[11]],
        &[0.432, -0.149, 0.660 + 0.432],
        1e-12,
    );
    assert!(
        ask(&sorm, "kin.puma600 CTRL -dump")
            .text
            .contains("-d1 0.66 ")
    );
    assert!(ask(&sorm, "kin.puma600 CTRL -d1 0").is_ok());
    let low = floats(&sorm, "kin.puma600 EXEC TMSG fkine", &[0.0; 6]);
    assert!((at_zero[11] - low[11] - 0.66).abs() < 1e-12);
}

#[test]
fn forward_dynamics_undo_inverse_dynamics_of_every_arm() {
    let sorm = manager();
    for (arm, n) in BUILT_IN {
        let q: Vec<f64> = (0..n).map(|i| 0.3 * (i as f64 + 1.0).sin()).collect();
        let qd: Vec<f64> = (0..n).map(|i| 0.5 * (2.0 * i as f64).cos()).collect();
        let qdd: Vec<f64> = (0..n).map(|i| (3.0 * i as f64).sin()).collect();
        for options in ["-rotor off", "-rotor on -friction on"] {
            assert!(ask(&sorm, &format!("dyn.{arm} CTRL {options}")).is_ok());
            let torques = floats(
                &sorm,
                &format!("dyn.{arm} EXEC TMSG rne"),
                &[&q[..], &qd, &qdd].concat(),
            );
            let found = floats(
                &sorm,
                &format!("dyn.{arm} EXEC TMSG fdyn"),
                &[&q[..], &qd, &torques].concat(),
            );
            near(&found, &qdd, 1e-8);
        }
    }
}

#[test]
fn inverse_kinematics_from_a_start_reach_the_pose_of_every_arm_within_its_limits() {
    let sorm = manager();
    for (arm, n) in BUILT_IN {
        let model = crate::model::built_in::model(arm, crate::model::file::Inertias::Identified);
        let model = model.unwrap().unwrap();
        for round in 0..8 {
            let within = |index: usize, salt: f64| {
                let limits = &model.joints()[index].limits;
                let share = 0.5 + 0.45 * (salt + 7.1 * index as f64 + 1.7 * f64::from(round)).sin();
                limits.lower + share * (limits.upper - limits.lower)
            };
            let q: Vec<f64> = (0..n).map(|index| within(index, 0.3)).collect();
            let start: Vec<f64> = (0..n).map(|index| within(index, 2.9)).collect();
            let pose = floats(&sorm, &format!("kin.{arm} EXEC TMSG fkine"), &q);
            let found = floats(
                &sorm,
                &format!("kin.{arm} EXEC TMSG ikine"),
                &[&pose[..], &start].concat(),
            );
            assert_eq!(found.len(), n);
            near(
                &floats(&sorm, &format!("kin.{arm} EXEC TMSG fkine"), &found),
                &pose,
                1e-8,
            );
            assert_eq!(model.joint_outside(&found), None, "{arm}: {found:?}");
            if arm == "testbed18" {
                assert_eq!(found[9..], start[9..], "the other arm stays");
            }
        }
    }
}

#[test]
fn a_pose_that_a_redundant_arm_cannot_take_is_refused_by_name() {
    let sorm = manager();
    let ask = |x: f64, z: f64| {
        let mut given = vec![
            1.0, 0.0, 0.0, x, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, z, 0.0, 0.0, 0.0, 1.0,
        ];
        given.extend([0.0; 9]);
        compute(&sorm, "kin.testbed9 EXEC TMSG ikine", &given)
    };
    let far = ask(9.0, 1.0);
    assert_eq!((far.code, far.floats.len()), (code::UNREACHABLE, 0));
    let text = &far.reports.last().unwrap().text;
    assert!(
        text.starts_with("unreachable: out of reach: the goal is"),
        "{text}"
    );
    // Within the length of all links, but the track ends.
    let beyond = ask(3.6, 1.0);
    assert_eq!((beyond.code, beyond.floats.len()), (code::UNREACHABLE, 0));
    let text = &beyond.reports.last().unwrap().text;
    assert!(text.starts_with("unreachable: not found: from"), "{text}");
    let short = compute(&sorm, "kin.testbed9 EXEC TMSG ikine", &[0.0; 16]);
    let text = &short.reports.last().unwrap().text;
    assert!(
        text.contains("ikine takes 25 floats") && text.contains("to start from"),
        "{text}"
    );
}

/// The PUMA 560 as a URDF whose zero positions, axes and frames are not those of its DH table.
fn puma_urdf() -> String {
    let mut text = "<robot name='other'><link name='floor'/>".to_owned();
    // Each joint's frame in the one before: the DH table at position 0, turned by half a turn about x where the axis is -z.
    let rows = [
        ("0 0 0.67183", "0 0 0.4", "0 0 1"),
        ("0 0 0", "1.5707963267948966 0 0", "0 0 1"),
        ("0.4318 0 0.15005", "0 0 0.3", "0 0 -1"),
        ("0.0203 0 0", "-1.5707963267948966 0 0", "0 0 2"),
        ("0 0 0.4318", "1.5707963267948966 0 0.2", "0 0 1"),
        ("0 0 0", "-1.5707963267948966 0 0", "0 0 1"),
    ];
    for (index, (xyz, rpy, axis)) in (1..).zip(rows) {
        let parent = if index == 1 {
            "floor".to_owned()
        } else {
            format!("l{}", index - 1)
        };
        text += &format!(
            "<link name='l{index}'/><joint name='j{index}' type='revolute'><origin xyz='{xyz}' rpy='{rpy}'/>\
             <parent link='{parent}'/><child link='l{index}'/><axis xyz='{axis}'/>\
             <limit lower='-3' upper='3' velocity='2' effort='9'/></joint>"
        );
    }
    text += "<link name='tool'/><joint name='t' type='fixed'><origin xyz='0.01 0.02 0.1' rpy='0.1 0.2 0.3'/>\
             <parent link='l6'/><child link='tool'/></joint></robot>";
    text
}

#[test]
fn a_pumas_geometry_in_a_urdf_has_all_solutions_in_closed_form_and_takes_a_start_as_well() {
    let sorm = manager();
    let file = Scratch::new("puma.urdf", &puma_urdf());
    let set = ask(
        &sorm,
        &format!("kin CTRL -urdf {} -base floor -tip tool", file.path()),
    );
    assert!(set.is_ok(), "{:?}", set.reports);
    for q in [
        [0.4, -0.7, 1.2, 0.5, 0.9, -1.0],
        [-1.4, 0.2, 2.0, -2.5, -0.6, 2.2],
    ] {
        let pose = floats(&sorm, "kin EXEC TMSG fkine", &q);
        let reply = compute(&sorm, "kin EXEC TMSG ikine", &pose);
        assert!(reply.is_ok(), "{:?}", reply.reports);
        let mut came_from = false;
        for found in reply.floats.chunks(6) {
            near(&floats(&sorm, "kin EXEC TMSG fkine", found), &pose, 1e-9);
            came_from |= found.iter().zip(&q).all(|(a, b)| (a - b).abs() < 1e-8);
        }
        assert!(came_from, "{q:?} is not in {:?}", reply.floats);
        let start = q.map(|position| position + 0.1);
        let found = floats(&sorm, "kin EXEC TMSG ikine", &[&pose[..], &start].concat());
        near(&found, &q, 1e-8);
    }
}

#[test]
fn an_arm_of_a_file_that_is_wrong_is_refused_with_the_place_and_leaves_the_one_before() {
    let sorm = manager();
    let before = floats(&sorm, "kin EXEC TMSG fkine", &POSE);
    let file = Scratch::new(
        "broken.urdf",
        "<robot name='a'>\n  <link name='b'/>\n  <link name='b'/>\n</robot>",
    );
    let (code, text) = refused(&sorm, &format!("kin CTRL -urdf {}", file.path()));
    assert_eq!(code, code::MODEL);
    assert!(
        text.contains("broken.urdf:3:15: error: duplicate name"),
        "{text}"
    );
    let toml = Scratch::new(
        "broken.toml",
        "name = \"a\"\n[[joint]]\nname = \"b\"\ntype = \"ball\"\n",
    );
    let (code, text) = refused(&sorm, &format!("dyn CTRL -model {}", toml.path()));
    assert_eq!(code, code::MODEL);
    assert!(text.contains("broken.toml:4:8: error: "), "{text}");
    for name in ["/no/such/file", "/dev/zero", "/"] {
        let (code, text) = refused(&sorm, &format!("kin CTRL -urdf {name}"));
        assert_eq!(code, code::MODEL);
        assert!(text.starts_with("cannot read"), "{text}");
    }
    assert_eq!(floats(&sorm, "kin EXEC TMSG fkine", &POSE), before);
    assert!(ask(&sorm, "kin CTRL -dump").text.contains("-urdf \"\""));
}

#[test]
fn torques_on_what_has_no_inertia_give_no_accelerations_but_a_reason() {
    let sorm = manager();
    let file = Scratch::new(
        "light.urdf",
        "<robot name='a'><link name='b'/><link name='c'/><joint name='j' type='continuous'>\
         <parent link='b'/><child link='c'/></joint></robot>",
    );
    let set = ask(&sorm, &format!("dyn CTRL -urdf {}", file.path()));
    assert!(set.is_ok());
    assert!(
        set.reports[0]
            .text
            .contains("warning: link `c` has no <inertial>"),
        "{:?}",
        set.reports
    );
    assert_eq!(floats(&sorm, "dyn EXEC TMSG gravity", &[0.5]), [0.0]);
    let reply = compute(&sorm, "dyn EXEC TMSG fdyn", &[0.0, 0.0, 1.0]);
    assert_eq!(reply.code, code::NO_INERTIA);
    assert!(
        reply
            .reports
            .last()
            .unwrap()
            .text
            .ends_with("joint 1 carries resists it (`j`)")
    );
}

#[test]
fn a_model_of_ones_own_comes_from_a_file_and_its_parts_from_beside_it_or_from_here() {
    let sorm = manager();
    let file = Scratch::new(
        "own.toml",
        "name = \"own\"\nbase = \"ground\"\n[[joint]]\nname = \"slide\"\ntype = \"prismatic\"\naxis = [1, 0, 0]\n\
         [[part]]\nname = \"arm\"\nmodel = \"puma560\"\nat = { xyz = [0, 0, 1] }\n",
    );
    assert!(ask(&sorm, &format!("kin CTRL -model {}", file.path())).is_ok());
    let found = floats(
        &sorm,
        "kin EXEC TMSG fkine",
        &[0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    );
    near(
        &[found[3], found[7], found[11]],
        &[0.9521, -0.15005, 2.10363],
        1e-12,
    );
}
