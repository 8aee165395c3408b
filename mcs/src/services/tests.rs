//! The classes `kin` and `dyn` by their textual requests: published answers, identities that hold for
//! any arm, and every way to ask wrongly.

mod arms;
mod paths;

use super::*;
use crate::model::{Model, built_in, file::Inertias};
use ctos::diagnostic::Source;
use nalgebra::{DMatrix, Matrix3, Matrix4};
use proptest::prelude::*;
use sorma::{Dictionary, Reply, Request, Transport};

fn manager() -> Sorm {
    let mut dictionary = Dictionary::new();
    dictionary.load(&Source::new("mcs", DICTIONARY)).unwrap();
    let sorm = Sorm::new(dictionary);
    register(&sorm);
    sorm
}

/// The reply to a line of text, read back from text.
fn ask(sorm: &Sorm, line: &str) -> Transport {
    sorm.dispatch(line).parse::<Reply>().unwrap().body
}

/// A request with floats, through text both ways.
fn compute(sorm: &Sorm, request: &str, floats: &[f64]) -> Transport {
    let mut request: Request = request.parse().unwrap();
    request.body.floats = floats.to_vec();
    ask(sorm, &request.to_text().unwrap())
}

fn floats(sorm: &Sorm, request: &str, given: &[f64]) -> Vec<f64> {
    let reply = compute(sorm, request, given);
    assert!(reply.is_ok(), "{request}: {:?}", reply.reports);
    assert!(reply.text.is_empty());
    reply.floats
}

fn near(found: &[f64], expected: &[f64], within: f64) {
    assert_eq!(found.len(), expected.len());
    for (index, (found, expected)) in found.iter().zip(expected).enumerate() {
        assert!(
            (found - expected).abs() <= within,
            "{index}: {found} is not {expected}"
        );
    }
}

/// The error's code and text of a request that is refused, with nothing else in the reply.
fn refused(sorm: &Sorm, line: &str) -> (i32, String) {
    let reply = ask(sorm, line);
    assert!(!reply.is_ok(), "{line}");
    assert!(reply.floats.is_empty() && reply.ints.is_empty() && reply.text.is_empty());
    let last = reply.reports.last().unwrap();
    assert!(!last.object.is_empty() && last.line > 0, "{last:?}");
    (reply.code, last.text.clone())
}

const POSE: [f64; 6] = [0.5, -0.5, 0.5, -0.5, 0.5, -0.5];

#[test]
fn forward_kinematics_are_the_published_ones() {
    let sorm = manager();
    let at_zero = floats(&sorm, "kin.puma560 EXEC TMSG fkine", &[0.0; 6]);
    #[rustfmt::skip]
    let expected = [
        1.0, 0.0, 0.0, 0.4521,
        0.0, 1.0, 0.0, -0.15005,
        0.0, 0.0, 1.0, 1.10363,
        0.0, 0.0, 0.0, 1.0,
    ];
    near(&at_zero, &expected, 1e-12);
    let found = floats(&sorm, "kin.puma560 EXEC TMSG fkine", &POSE);
    near(
        &found[0..3],
        &[0.770_151_153, 0.420_735_492, -0.479_425_539],
        5e-10,
    );
    let origin = [found[3], found[7], found[11]];
    near(
        &origin,
        &[0.422_303_996, 0.059_724_661, 0.896_614_052],
        5e-10,
    );
}

#[test]
fn the_joints_of_an_arm_are_told_with_their_names_units_and_limits() {
    let sorm = manager();
    let joint = |index: usize| {
        let slots = ask(&sorm, "slots.any EXEC");
        assert_eq!(slots.floats.len(), 36);
        slots.floats[6 * index..][..6].to_vec()
    };
    let named = ask(&sorm, "slots.any EXEC").text;
    assert_eq!(named.lines().count(), 6);
    assert!(
        named.lines().all(|line| line.ends_with(", rad, N m")),
        "{named}"
    );
    let before = joint(0);
    assert!(ask(&sorm, "mvpos EXEC by FMSG 6 0.25 0 0 0 0 0").is_ok());
    near(&joint(0)[..1], &[before[0] + 0.25], 1e-12);
    let [.., lower, upper, most] = joint(0)[..] else {
        panic!("six numbers");
    };
    // The waist of a PUMA 560 turns through 320 degrees.
    near(&[upper - lower], &[320_f64.to_radians()], 1e-9);
    assert!(most > 0.0);
    assert!(!ask(&sorm, "slots EXEC now").is_ok());
}

#[test]
fn dynamics_are_the_published_ones() {
    let sorm = manager();
    let gravity = floats(&sorm, "dyn.puma560 EXEC TMSG gravity", &POSE);
    let published = [0.0, 33.404_608_849, 0.237_041_794, 0.0, -0.013_545_114, 0.0];
    near(&gravity, &published, 5e-10);
    let mut given = [1.0; 18];
    given[..6].copy_from_slice(&POSE);
    let rigid = floats(&sorm, "dyn.puma560 EXEC TMSG rne", &given);
    #[rustfmt::skip]
    let published = [2.162_084_304, 34.157_004_464, 1.338_393_456, 0.005_147_848, -0.008_551_583, 0.000_019_806];
    near(&rigid, &published, 5e-10);
    assert!(ask(&sorm, "dyn.puma560 CTRL -rotor on").is_ok());
    let rotors = floats(&sorm, "dyn.puma560 EXEC TMSG rne", &given);
    #[rustfmt::skip]
    let published = [2.946_114_273, 36.481_819_309, 1.915_266_788, 0.195_938_475, 0.162_154_709, 0.194_084_311];
    near(&rotors, &published, 5e-10);
}

/// |G| (B |G| qd + Tc of the direction), from the table of the motors.
#[test]
fn friction_is_the_motors_table() {
    const GEARS: [f64; 6] = [62.6111, 107.815, 53.7063, 76.0364, 71.923, 76.686];
    const VISCOUS: [f64; 6] = [1.48e-3, 0.817e-3, 1.38e-3, 71.2e-6, 82.6e-6, 36.7e-6];
    const FORWARD: [f64; 6] = [0.395, 0.126, 0.132, 0.0112, 0.00926, 0.00396];
    const BACKWARD: [f64; 6] = [-0.435, -0.071, -0.105, -0.0169, -0.0145, -0.0105];
    let sorm = manager();
    assert!(
        ask(
            &sorm,
            "dict CTRL -add dyn.f '-SUBST dyn.puma560 -friction on'"
        )
        .is_ok()
    );
    for (speed, coulomb) in [(0.7, FORWARD), (-0.7, BACKWARD)] {
        let mut given = [0.0; 18];
        given[..6].copy_from_slice(&POSE);
        given[6..12].fill(speed);
        let without = floats(&sorm, "dyn.puma560 EXEC TMSG rne", &given);
        let with = floats(&sorm, "dyn.f EXEC TMSG rne", &given);
        for joint in 0..6 {
            let gear = GEARS[joint];
            let expected = gear * (VISCOUS[joint] * gear * speed + coulomb[joint]);
            assert!((with[joint] - without[joint] - expected).abs() < 1e-9);
        }
    }
}

#[test]
fn a_pose_that_the_arm_cannot_take_is_refused_by_name() {
    let sorm = manager();
    let pose = |x: f64, y: f64, z: f64| {
        format!("kin.puma560 EXEC TMSG ikine FMSG 16 1 0 0 {x:?} 0 1 0 {y:?} 0 0 1 {z:?} 0 0 0 1")
    };
    let (code, text) = refused(&sorm, &pose(2.0, 0.0, 0.6));
    assert_eq!(code, code::UNREACHABLE);
    assert!(text.starts_with("unreachable: out of reach:"), "{text}");
    let (code, text) = refused(&sorm, &pose(0.05, 0.05, 0.9));
    assert_eq!(code, code::UNREACHABLE);
    assert!(
        text.starts_with("unreachable: inside the shoulder:"),
        "{text}"
    );
    let (code, _) = refused(&sorm, &pose(1e300, 0.0, 0.0));
    assert_eq!(code, code::UNREACHABLE);
    // Straight above the zero position the wrist is singular.
    let (code, text) = refused(&sorm, &pose(0.4521, -0.15005, 1.10363));
    assert_eq!(code, code::SINGULAR);
    assert!(
        text.starts_with("singular: the wrist, where with joint 5 at"),
        "{text}"
    );
    assert!(
        ask(
            &sorm,
            "kin.puma560 CTRL -singular near -near 0 0 0 0.25 0 0"
        )
        .is_ok()
    );
    let kept = ask(&sorm, &pose(0.4521, -0.15005, 1.10363));
    assert!(kept.is_ok() && kept.reports[0].code == code::SINGULAR);
    let wanted = [0.0, 0.0, 0.0, 0.25, 0.0, -0.25];
    let found = kept.floats.chunks(6).any(|joints| {
        joints
            .iter()
            .zip(&wanted)
            .all(|(a, b)| (a - b).abs() < 1e-7)
    });
    assert!(found, "{:?}", kept.floats);
    // The hand upwards, low before the arm: joint 5 would have to be beyond its 100 degrees.
    let (code, text) = refused(&sorm, &pose(0.7, 0.0, 0.2));
    assert_eq!(code, code::LIMITS, "{text}");
    assert!(text.starts_with("outside joint limits in every posture: in the best of them joint"));
    assert!(ask(&sorm, "kin.puma560 CTRL -limits off").is_ok());
    assert_eq!(ask(&sorm, &pose(0.7, 0.0, 0.2)).ints, [8]);
}

/// The answer to `ikine` for the pose of these joints, from `start` where there is one.
fn inverse_of(sorm: &Sorm, kin: &str, q: &[f64], start: &[f64]) -> Transport {
    let mut pose = floats(sorm, &format!("{kin} EXEC fkine"), q);
    pose.extend(start);
    compute(sorm, &format!("{kin} EXEC ikine"), &pose)
}

/// What an answer says besides.
fn said(reply: &Transport) -> Vec<(i32, &str)> {
    let reports = reply.reports.iter();
    let reports = reports.map(|report| (report.code, report.text.as_str()));
    reports.collect()
}

#[test]
fn a_stretched_elbow_and_a_shoulder_over_its_axis_are_named_beside_their_solutions() {
    let sorm = manager();
    // The elbow is straight where the forearm, a3 and d4, is in line with the upper arm.
    let straight = -(0.4318_f64).atan2(0.0203);
    // The wrist is over the shoulder where a2 cos q2 + a3 cos (q2 + q3) - d4 sin (q2 + q3) = 0.
    let (q2, a2, a3, d4) = (1.0_f64, 0.4318_f64, 0.0203_f64, 0.4318_f64);
    let over = (a2 * q2.cos() / a3.hypot(d4)).asin() + a3.atan2(d4) - q2;
    let sound = [0.3, 0.4, -2.5, 0.2, 0.6, 1.0];
    for start in [&[][..], &sound] {
        let found = inverse_of(&sorm, "kin.puma560", &sound, start);
        assert!(
            found.is_ok() && found.reports.is_empty(),
            "{:?}",
            found.reports
        );
    }
    for (q, name) in [
        ([0.2, 0.5, straight, 0.0, 0.3, 0.0], "singular elbow: "),
        ([0.2, q2, over, 0.4, 0.6, 0.1], "singular shoulder: "),
    ] {
        for start in [&[][..], &q] {
            let found = inverse_of(&sorm, "kin.puma560", &q, start);
            let said = said(&found);
            assert!(found.is_ok(), "{said:?}");
            let [(code::MEET, text)] = said[..] else {
                panic!("{name}: {said:?}")
            };
            assert!(text.starts_with(name), "{text}");
            let near = |joints: &[f64]| joints.iter().zip(&q).all(|(a, b)| (a - b).abs() < 1e-6);
            assert!(
                found.floats.chunks(6).any(near),
                "{name}: {:?}",
                found.floats
            );
        }
    }
}

#[test]
fn all_singularities_of_a_pose_are_named_and_a_start_says_where_joint_four_stays() {
    let sorm = manager();
    let straight = -(0.4318_f64).atan2(0.0203);
    let wrist = [0.2, 0.5, -2.5, 0.4, 0.0, 0.1];
    let found = inverse_of(&sorm, "kin.puma560", &wrist, &wrist);
    near(&found.floats, &wrist, 1e-7);
    let [(code::SINGULAR, text)] = said(&found)[..] else {
        panic!("{:?}", found.reports)
    };
    assert!(
        text.starts_with("singular: the wrist, where with joint 5 at"),
        "{text}"
    );
    assert!(text.ends_with("joint 4 stays where it starts"), "{text}");
    // An elbow as straight as the wrist: both are told, where the wrist's is an error, too.
    let both = [0.2, 0.5, straight, 0.4, 0.0, 0.1];
    for start in [&[][..], &both] {
        let found = inverse_of(&sorm, "kin.puma560", &both, start);
        assert_eq!(found.is_ok(), !start.is_empty());
        let codes: Vec<i32> = said(&found).iter().map(|(code, _)| *code).collect();
        assert_eq!(codes, [code::MEET, code::SINGULAR]);
    }
}

#[test]
fn an_arm_that_is_searched_for_says_which_way_its_tip_cannot_move() {
    let sorm = manager();
    let sound = [0.2, 0.1, -0.1, 0.1, 0.8, -2.6, 0.2, 0.7, 0.1];
    let found = inverse_of(&sorm, "kin.testbed9", &sound, &sound);
    assert!(
        found.is_ok() && found.reports.is_empty(),
        "{:?}",
        found.reports
    );
    // The cart and the first three joints alone: upright and straight on, no axis of them is along the cart's heading.
    assert!(ask(&sorm, "kin CTRL -arm testbed9 -tip arm.link3").is_ok());
    let q = [0.2, 0.3, 0.0, 0.0, 0.8, -2.6, 0.2, 0.7, 0.1];
    let found = inverse_of(&sorm, "kin", &q, &q);
    near(&found.floats, &q, 1e-7);
    let [(code::MEET, text)] = said(&found)[..] else {
        panic!("{:?}", found.reports)
    };
    assert!(
        text.starts_with("singular: with these joint positions the tip cannot turn about "),
        "{text}"
    );
    let words = text.split("about ").nth(1).unwrap().split(' ');
    let way: Vec<f64> = words.take(3).map(|word| word.parse().unwrap()).collect();
    let aside = way[0] * 0.3_f64.sin() - way[1] * 0.3_f64.cos();
    assert!(aside.abs() < 1e-2 && way[2].abs() < 1e-2, "{text}");
    assert!(
        text.contains("the smallest singular value of its Jacobian is "),
        "{text}"
    );
}

#[test]
fn wrong_requests_say_what_would_have_been_right() {
    let sorm = manager();
    let cases = [
        (
            "kin.puma560 EXEC",
            "after EXEC stands one of fkine, jacobian, ikine",
        ),
        (
            "kin.puma560 EXEC TMSG fkin FMSG 6 0 0 0 0 0 0",
            "EXEC `fkin` is not known here: this class has fkine, jacobian, ikine; did you mean `fkine`?",
        ),
        (
            "kin.puma560 EXEC TMSG fkine FMSG 5 0 0 0 0 0",
            "EXEC fkine takes 6 floats (joint positions q1 to q6, rad), not 5: write FMSG 6 and the numbers",
        ),
        (
            "kin EXEC TMSG fkine FMSG 6 0 0 nan 0 0 0",
            "EXEC fkine takes finite floats (joint positions q1 to q6, rad), and float 3 of 6 is NaN",
        ),
        (
            "dyn.puma560 EXEC TMSG rne FMSG 6 0 0 0 0 0 0",
            "EXEC rne takes 18 floats (6 positions in rad, 6 speeds in rad/s, 6 accelerations in rad/s^2), \
             not 6: write FMSG 18 and the numbers",
        ),
        (
            "dyn.puma560 EXEC TMSG gravity FMSG 6 0 0 0 0 0 0 IMSG 1 3",
            "EXEC gravity takes no whole numbers (IMSG), not 1",
        ),
        (
            "dyn.puma560 EXEC TMSG rne FMSG 18 0 0 0 0 0 0 1e200 0 0 0 0 0 0 0 0 0 0 0",
            "EXEC rne: speeds or accelerations are too large to compute with",
        ),
        (
            "kin.puma560 EXEC TMSG ikine FMSG 16 1 0 0 0 0 1 0 0 0 0 1 0 0.4 0 0.9 1",
            "the last row of base_T_6 is 0 0 0 1, not [0.4, 0.0, 0.9, 1.0]; the 16 numbers go row by row",
        ),
        (
            "kin.puma560 EXEC TMSG ikine FMSG 16 1 0 0 0.4 0 1 0 0 0 0 -1 0.5 0 0 0 1",
            "the rotation in base_T_6 is mirrored: its determinant is -1, not 1",
        ),
        (
            "kin.puma560 EXEC TMSG ikine FMSG 16 2 0 0 0.4 0 1 0 0 0 0 1 0.5 0 0 0 1",
            "the rotation in base_T_6 is none: its columns are not of length 1 and at right angles, they are off by 3.0e0",
        ),
        (
            "kin.puma560 CTRL -d1 9",
            "-d1: must be a number from 0.0 to 5.0 m, not `9`",
        ),
        (
            "kin.puma CTRL -help",
            "the dictionary has no recipe for `kin.puma`; did you mean `kin.puma560`?",
        ),
    ];
    for (line, expected) in cases {
        let reply = ask(&sorm, line);
        assert!(!reply.is_ok(), "{line}");
        assert_eq!(reply.reports.last().unwrap().text, expected, "{line}");
        assert!(reply.floats.is_empty(), "{line}: what came in is no answer");
    }
}

#[test]
fn options_change_one_flavor_and_are_told() {
    let sorm = manager();
    assert!(ask(&sorm, "dict CTRL -add kin.table '-SUBST kin.puma560 -d1 0'").is_ok());
    let low = floats(&sorm, "kin.table EXEC TMSG fkine", &POSE);
    let high = floats(&sorm, "kin.puma560 EXEC TMSG fkine", &POSE);
    assert!((high[11] - low[11] - 0.67183).abs() < 1e-12);
    let dump = ask(&sorm, "kin.table CTRL -dump").text;
    assert!(
        dump.starts_with("-arm puma560 -d1 0.0 -limits on"),
        "{dump}"
    );
    for class in classes() {
        let help = ask(&sorm, &format!("{} CTRL -help", class.name)).text;
        for form in &class.forms {
            assert!(help.contains(&format!("EXEC {}", form.text)), "{help}");
        }
    }
}

fn puma560() -> Model {
    built_in::model("puma560", Inertias::Identified)
        .unwrap()
        .unwrap()
}

fn joints_within(share: f64) -> impl Strategy<Value = [f64; 6]> {
    let model = puma560();
    prop::array::uniform6(-1.0..1.0_f64).prop_map(move |parts| {
        std::array::from_fn(|index| {
            let limit = &model.joints()[index].limits;
            let middle = 0.5 * (limit.lower + limit.upper);
            middle + share * parts[index] * 0.5 * (limit.upper - limit.lower)
        })
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn the_jacobian_is_the_derivative_of_forward_kinematics(q in joints_within(1.0)) {
        let sorm = manager();
        let of = |q: &[f64; 6]| floats(&sorm, "kin.puma560 EXEC TMSG fkine", q);
        let jacobian = floats(&sorm, "kin.puma560 EXEC TMSG jacobian", &q);
        let at = Matrix4::from_row_slice(&of(&q));
        for joint in 0..6 {
            let moved = |step: f64| {
                let mut q = q;
                q[joint] += step;
                Matrix4::from_row_slice(&of(&q))
            };
            let rate = (moved(1e-5) - moved(-1e-5)) / 2e-5;
            // dR/dt = [w] R.
            let turning: Matrix3<f64> = rate.fixed_view::<3, 3>(0, 0) * at.fixed_view::<3, 3>(0, 0).transpose();
            let numeric = [
                rate[(0, 3)], rate[(1, 3)], rate[(2, 3)],
                turning[(2, 1)], turning[(0, 2)], turning[(1, 0)],
            ];
            for (row, numeric) in numeric.iter().enumerate() {
                prop_assert!((jacobian[6 * row + joint] - numeric).abs() < 1e-8);
            }
        }
    }

    #[test]
    fn gravity_and_inertia_are_parts_of_inverse_dynamics(q in joints_within(1.0), rotor in any::<bool>()) {
        let sorm = manager();
        if rotor {
            ask(&sorm, "dyn.puma560 CTRL -rotor");
        }
        let rne = |qdd: [f64; 6]| {
            let given = [q, [0.0; 6], qdd].concat();
            floats(&sorm, "dyn.puma560 EXEC TMSG rne", &given)
        };
        let still = rne([0.0; 6]);
        near(&floats(&sorm, "dyn.puma560 EXEC TMSG gravity", &q), &still, 1e-10);
        let inertia = floats(&sorm, "dyn.puma560 EXEC TMSG inertia", &q);
        let matrix = DMatrix::from_row_slice(6, 6, &inertia);
        prop_assert!((&matrix - matrix.transpose()).amax() < 1e-10);
        prop_assert!(matrix.clone().cholesky().is_some(), "positive definite");
        for joint in 0..6 {
            let mut qdd = [0.0; 6];
            qdd[joint] = 1.0;
            let column: Vec<f64> = rne(qdd).iter().zip(&still).map(|(with, without)| with - without).collect();
            near(&column, matrix.column(joint).as_slice(), 1e-10);
        }
    }

    #[test]
    fn inverse_kinematics_find_every_way_to_a_pose(q in joints_within(0.98)) {
        let sorm = manager();
        let pose = floats(&sorm, "kin.puma560 EXEC TMSG fkine", &q);
        prop_assume!(q[4].sin().abs() > 1e-3);
        let reply = compute(&sorm, "kin.puma560 EXEC TMSG ikine", &pose);
        prop_assert!(reply.is_ok(), "{:?}", reply.reports);
        prop_assert_eq!(reply.ints, [(reply.floats.len() / 6) as i64]);
        let solutions: Vec<&[f64]> = reply.floats.chunks(6).collect();
        let far = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        prop_assert!(solutions.iter().any(|found| far(found, &q) < 1e-6), "{:?} not in {:?}", q, solutions);
        let model = puma560();
        for (index, found) in solutions.iter().enumerate() {
            near(&floats(&sorm, "kin.puma560 EXEC TMSG fkine", found), &pose, 1e-8);
            prop_assert_eq!(model.joint_outside(found), None);
            for other in &solutions[..index] {
                prop_assert!(far(found, other) > 1e-9, "one solution twice");
            }
        }
    }

    #[test]
    fn any_numbers_are_answered_or_refused(
        text in prop::sample::select(vec!["fkine", "jacobian", "ikine"]),
        numbers in prop::collection::vec(prop::num::f64::ANY, 0..20),
    ) {
        let sorm = manager();
        let reply = compute(&sorm, &format!("kin EXEC TMSG {text}"), &numbers);
        prop_assert!(reply.is_ok() || !reply.reports.is_empty());
        prop_assert!(reply.floats.iter().all(|float| float.is_finite()));
    }
}

/// The reply of an object that may wait, in a process without an app.
fn tell(sorm: &Sorm, line: &str) -> Transport {
    use futures_util::FutureExt as _;
    let told = sorm.tell(&sorma::Alone, line, "").now_or_never().unwrap();
    told.parse::<Reply>().unwrap().body
}

fn done(sorm: &Sorm, line: &str) -> Vec<f64> {
    let reply = tell(sorm, line);
    assert!(reply.is_ok(), "{line}: {:?}", reply.reports);
    reply.floats
}

fn angles(joints: &[f64]) -> String {
    let words: Vec<String> = joints.iter().map(|joint| format!("{joint:?}")).collect();
    format!("FMSG {} {}", words.len(), words.join(" "))
}

#[test]
fn the_arm_of_the_process_goes_where_it_is_told_and_pino_sees_it_there() {
    let sorm = manager();
    let goal = [0.3, 0.9, -1.2, 0.1, 0.6, -0.4];
    let moved = done(&sorm, &format!("mvpos EXEC joints {}", angles(&goal)));
    near(&moved[..6], &goal, 1e-12);
    assert!(moved[6] > 0.0);
    // What it says of its tool is what kinematics say.
    let seen = done(&sorm, "pino EXEC state");
    near(&seen[..6], &goal, 1e-12);
    let expected = floats(&sorm, "kin.puma560 EXEC TMSG fkine", &goal);
    near(&seen[6..], &expected, 1e-9);
    // On by a bit and back again is where it was.
    let by = [0.1, -0.2, 0.3, -0.1, 0.2, 0.5];
    let there = done(&sorm, &format!("mvpos EXEC by {}", angles(&by)));
    near(
        &there[..6],
        &std::array::from_fn::<f64, 6, _>(|i| goal[i] + by[i]),
        1e-12,
    );
    let back = by.map(|joint: f64| -joint);
    let there = done(&sorm, &format!("mvpos EXEC by {}", angles(&back)));
    near(&there[..6], &goal, 1e-12);
}

#[test]
fn cartesian_motions_move_the_tool_as_said() {
    let sorm = manager();
    let before = done(&sorm, "mvpos EXEC where");
    tell(&sorm, "mvpos CTRL -path line");
    done(&sorm, "mvpos EXEC shift FMSG 6 0.05 -0.04 0.03 0 0 0");
    let after = done(&sorm, "mvpos EXEC where");
    for (index, by) in [(9, 0.05), (13, -0.04), (17, 0.03)] {
        assert!((after[index] - before[index] - by).abs() < 1e-9);
    }
    for index in [6, 7, 8, 10, 11, 12, 14, 15, 16] {
        assert!((after[index] - before[index]).abs() < 1e-9, "it turned");
    }
    let pose = angles(&before[6..]);
    done(&sorm, &format!("mvpos EXEC pose {pose}"));
    let back = done(&sorm, "mvpos EXEC where");
    near(&back[6..], &before[6..], 1e-8);
    let [x, y, z] = [before[9], before[13], before[17]];
    let now = nalgebra::Matrix3::from_fn(|row, column| before[6 + 4 * row + column]);
    let now = nalgebra::Rotation3::from_matrix_unchecked(now);
    let (roll, pitch, yaw) =
        (now * nalgebra::Rotation3::from_euler_angles(0.1, -0.1, 0.2)).euler_angles();
    done(
        &sorm,
        &format!("mvpos EXEC place FMSG 6 {x} {y} {z} {roll} {pitch} {yaw}"),
    );
    let turned = done(&sorm, "mvpos EXEC where");
    let expected = nalgebra::Rotation3::from_euler_angles(roll, pitch, yaw);
    for row in 0..3 {
        for column in 0..3 {
            let found = turned[6 + 4 * row + column];
            assert!((found - expected[(row, column)]).abs() < 1e-8);
        }
    }
}

#[test]
fn a_transformation_moves_the_tool_along_its_own_axes_and_a_reference_shifts_poses() {
    let sorm = manager();
    let frame = |numbers: &[f64]| {
        let numbers: Vec<f64> = numbers[6..22].to_vec();
        nalgebra::Matrix4::from_row_slice(&numbers)
    };
    let before = frame(&done(&sorm, "mvpos EXEC where"));
    let by = nalgebra::Isometry3::new(
        nalgebra::Vector3::new(0.02, -0.01, 0.03),
        nalgebra::Vector3::new(0.05, 0.1, -0.08),
    );
    let by = by.to_homogeneous();
    let rows: Vec<f64> = by.transpose().iter().copied().collect();
    done(&sorm, &format!("mvpos EXEC relative {}", angles(&rows)));
    let after = frame(&done(&sorm, "mvpos EXEC where"));
    assert!((after - before * by).amax() < 1e-8);
    // Back to where it came from, given in a frame that stands 0.1 m higher and is turned by a quarter.
    let quarter = std::f64::consts::FRAC_PI_2;
    tell(
        &sorm,
        &format!("mvpos.table CTRL -reference 0 0 0.1 0 0 {quarter}"),
    );
    let table = nalgebra::Isometry3::new(
        nalgebra::Vector3::new(0.0, 0.0, 0.1),
        nalgebra::Vector3::new(0.0, 0.0, quarter),
    );
    let seen = table.inverse().to_homogeneous() * before;
    let rows: Vec<f64> = seen.transpose().iter().copied().collect();
    done(&sorm, &format!("mvpos.table EXEC pose {}", angles(&rows)));
    let there = frame(&done(&sorm, "mvpos EXEC where"));
    assert!((there - before).amax() < 1e-8);
}

#[test]
fn acceleration_is_scaled_apart_from_speed() {
    let sorm = manager();
    let how_long = |options: &str| {
        tell(
            &sorm,
            &format!("mvpos.{} CTRL -plan {options}", options.len()),
        );
        let line = format!(
            "mvpos.{} EXEC joints FMSG 6 0.4 0.9 -1.2 0 0.6 0",
            options.len()
        );
        done(&sorm, &line)[6]
    };
    let alike = how_long("-speed 0.5");
    let same = how_long("-speed 0.5 -acceleration 0.5");
    let gentle = how_long("-speed 0.5 -acceleration 0.1");
    let hard = how_long("-speed 0.5 -acceleration 1");
    assert!((alike - same).abs() < 1e-12);
    assert!(gentle > alike && alike > hard, "{gentle} {alike} {hard}");
    let refused = tell(&sorm, "mvpos CTRL -acceleration 1.5");
    assert!(!refused.is_ok());
}

#[test]
fn positions_have_names_and_a_flavor_has_one_of_its_own() {
    let sorm = manager();
    let ready = done(&sorm, "mvpos EXEC ready");
    near(&ready[..2], &[0.0, std::f64::consts::FRAC_PI_2], 1e-12);
    let home = done(&sorm, "mvpos.home EXEC");
    tell(
        &sorm,
        "dict CTRL -add position.shelf '0.1 0.8 -1.5 0 0.7 0.2'",
    );
    let shelf = done(&sorm, "mvpos EXEC shelf");
    near(&shelf[..6], &[0.1, 0.8, -1.5, 0.0, 0.7, 0.2], 1e-12);
    near(&done(&sorm, "mvpos EXEC home")[..6], &home[..6], 1e-12);
    // One that is planned is where it was.
    tell(&sorm, "mvpos.try CTRL -plan -speed 0.1");
    let slow = done(&sorm, "mvpos.try EXEC shelf");
    tell(&sorm, "mvpos.try CTRL -speed 0.5");
    let fast = done(&sorm, "mvpos.try EXEC shelf");
    assert!(slow[6] > 2.0 * fast[6]);
    assert_eq!(slow[..6], fast[..6]);
    near(&done(&sorm, "mvpos EXEC where")[..6], &home[..6], 1e-12);
}

#[test]
fn a_motion_that_cannot_be_made_moves_nothing_and_says_what_is_in_the_way() {
    let sorm = manager();
    let before = done(&sorm, "mvpos EXEC where");
    let refused = |line: &str| {
        let reply = tell(&sorm, line);
        assert!(!reply.is_ok() && reply.floats.is_empty(), "{line}");
        (reply.code, reply.reports.last().unwrap().text.clone())
    };
    let (far, text) = refused("mvpos EXEC joints FMSG 6 0 0 0 0 2 0");
    assert_eq!(far, code::MOTION);
    assert!(text.contains("joint 5"), "{text}");
    let (away, _) = refused("mvpos EXEC place FMSG 6 3 0 0 0 0 0");
    assert_eq!(away, code::MOTION);
    let (name, text) = refused("mvpos EXEC redy");
    assert_eq!(name, code::NO_POSITION);
    assert!(text.contains("position.ready"), "{text}");
    assert_eq!(refused("mvpos EXEC").0, code::NO_POSITION);
    tell(&sorm, "dict CTRL -add position.half '1 2 3'");
    assert_eq!(refused("mvpos EXEC half").0, code::NO_POSITION);
    for wrong in [
        "mvpos EXEC joints FMSG 5 0 0 0 0 0",
        "mvpos EXEC joints FMSG 6 0 0 nan 0 0 0",
        "mvpos EXEC joints",
        "pino EXEC set FMSG 1 8",
        "pino EXEC sing",
    ] {
        assert!(refused(wrong).0 < 100, "{wrong}");
    }
    assert_eq!(done(&sorm, "mvpos EXEC where"), before);
}

#[test]
fn along_positions_takes_as_long_as_one_after_the_other_and_blended_less() {
    let sorm = manager();
    let (a, b) = ("0.4 0.9 -2.4 0 0.6 0", "0.8 0.5 -2.6 0.3 0.2 0");
    let how_long = |options: &str, line: &str| {
        tell(&sorm, &format!("mvpos CTRL -plan -blend {options}"));
        done(&sorm, line)[6]
    };
    let along = format!("mvpos EXEC along FMSG 12 {a} {b}");
    let both = how_long("0", &along);
    let blended = how_long("0.5", &along);
    let first = how_long("0", &format!("mvpos EXEC joints FMSG 6 {a}"));
    assert!(
        first < blended && blended < both - 0.05,
        "{first} {blended} {both}"
    );
}

#[test]
fn times_of_trapezoids_and_of_stops_are_the_closed_forms() {
    let sorm = manager();
    // Joint 1 cruises, joint 2 does not come to it, joint 3 stays: 1/1 + 1/2, 2 sqrt(0.5/2), 0.
    let given = [
        3.0, 0.0, 1.0, 0.5, 1.0, 0.5, 0.5, 1.0, 5.0, 1.0, 2.0, 2.0, 2.0, 0.0, 0.0, 0.0,
    ];
    let found = floats(&sorm, "traj EXEC TMSG rest", &given);
    near(&found, &[1.5, 1.5, 1.0, 0.0], 1e-9);
    // The same from state to state with all speeds zero.
    let mut state = vec![3.0];
    for row in [
        [0.0, 1.0, 0.5],
        [0.0; 3],
        [0.0; 3],
        [1.0, 0.5, 0.5],
        [0.0; 3],
        [0.0; 3],
    ] {
        state.extend(row);
    }
    state.extend(&given[7..]);
    near(&floats(&sorm, "traj EXEC TMSG state", &state), &found, 1e-9);
    // v / a and v^2 / 2a; and 2 sqrt(v / j) with v sqrt(v / j) where the acceleration is never constant.
    let stop = [2.0, 2.0, -1.0, 0.0, 0.0, 4.0, 10.0, 0.0, 4.0];
    let found = floats(&sorm, "traj EXEC TMSG stop", &stop);
    near(&found, &[0.5, 1.0, 0.5, -0.5], 1e-9);
    let jerky = floats(
        &sorm,
        "traj EXEC TMSG rest",
        &[1.0, 0.0, 1.0, 9.0, 9.0, 32.0],
    );
    near(&jerky, &[1.0, 1.0], 1e-9);
}

#[test]
fn a_request_for_times_with_the_wrong_count_or_limit_says_what_is_right() {
    let sorm = manager();
    for (line, expected) in [
        (
            "traj EXEC TMSG rest",
            "EXEC rest takes the number of joints first",
        ),
        (
            "traj EXEC TMSG rest FMSG 1 1.5",
            "EXEC rest: the number of joints is 1 to 64, not 1.5",
        ),
        (
            "traj EXEC TMSG stop FMSG 4 2 1 1 1",
            "EXEC stop of 2 joints takes 9 floats, not 4",
        ),
        (
            "traj EXEC TMSG rest FMSG 6 1 0 1 1 0 0",
            "EXEC rest: the largest acceleration of joint 1 is 0; it must be above zero",
        ),
        (
            "traj EXEC TMSG state FMSG 10 1 0 0 0 1 2 0 1 1 1",
            "EXEC state: joint 1: the speed at the end, 2, is beyond its limit of 1",
        ),
        (
            "traj EXEC TMSG rest FMSG 6 1 0 1e200 1 1 1",
            "EXEC rest: the position at the end of joint 1 is 1e200; numbers must be finite and at most 1e6, limits at least 1e-6",
        ),
    ] {
        let reply = ask(&sorm, line);
        assert!(!reply.is_ok(), "{line}");
        assert_eq!(reply.reports.last().unwrap().text, expected, "{line}");
    }
}

#[test]
fn a_path_through_way_points_takes_less_than_stops_at_them_and_no_more_than_the_straight_line() {
    let sorm = manager();
    let path = |points: &[[f64; 2]], jerk: f64| {
        let rows = [[1.0, 2.0], [2.0, 4.0], [jerk, jerk]];
        let numbers: Vec<f64> = points.iter().chain(&rows).flatten().copied().collect();
        let line = format!("traj EXEC TMSG path IMSG 1 {}", points.len() - 2);
        let found = floats(&sorm, &line, &numbers);
        assert_eq!(found.len(), 1);
        found[0]
    };
    for jerk in [0.0, 20.0] {
        let (a, b) = ([0.0, 0.0], [2.0, 1.0]);
        let rest = [2.0, 0.0, 0.0, 2.0, 1.0, 1.0, 2.0, 2.0, 4.0, jerk, jerk];
        let straight = floats(&sorm, "traj EXEC TMSG rest", &rest)[0];
        near(&[path(&[a, b], jerk)], &[straight], 1e-9);
        // Joint 1 sets the time of the line and of its parts, in proportion to which joint 2 can go.
        let through = path(&[a, [0.5, 0.25], [1.4, 0.7], b], jerk);
        near(&[through], &[straight], 1e-6);
        let corner = [2.0, 3.0];
        let stops = path(&[a, corner], jerk) + path(&[corner, b], jerk);
        let through = path(&[a, corner, b], jerk);
        assert!(through < stops, "{through} {stops}");
    }
}

#[test]
fn a_path_that_makes_no_sense_is_refused_by_name() {
    let sorm = manager();
    for (line, expected) in [
        (
            "traj EXEC TMSG path FMSG 5 0 1 1 1 0",
            "EXEC path takes the number of way points: write IMSG 1 and it, not IMSG 0",
        ),
        (
            "traj EXEC TMSG path FMSG 5 0 1 1 1 0 IMSG 2 0 0",
            "EXEC path takes the number of way points: write IMSG 1 and it, not IMSG 2",
        ),
        (
            "traj EXEC TMSG path FMSG 5 0 1 1 1 0 IMSG 1 -1",
            "EXEC path goes through 0 to 100 way points, not -1",
        ),
        (
            "traj EXEC TMSG path FMSG 5 0 1 1 1 0 IMSG 1 9223372036854775807",
            "EXEC path goes through 0 to 100 way points, not 9223372036854775807",
        ),
        (
            "traj EXEC TMSG path FMSG 5 0 1 1 1 0 IMSG 1 1",
            "EXEC path with 1 way points takes 6 floats for each of 1 to 64 joints, not 5 in all",
        ),
        (
            "traj EXEC TMSG path IMSG 1 0",
            "EXEC path with 0 way points takes 5 floats for each of 1 to 64 joints, not 0 in all",
        ),
        (
            "traj EXEC TMSG path FMSG 5 0 1 1 0 0 IMSG 1 0",
            "EXEC path: the largest acceleration of joint 1 is 0; it must be above zero",
        ),
        (
            "traj EXEC TMSG path FMSG 5 0 1 1 1 -1 IMSG 1 0",
            "EXEC path: the largest jerk of joint 1 is -1; it must be above zero, or 0 for none",
        ),
        (
            "traj EXEC TMSG path FMSG 6 0 1 1 1 1 0 IMSG 1 1",
            "EXEC path: point 2 of the path is where point 1 is, the start being point 0; leave one of them out",
        ),
        (
            "traj EXEC TMSG path FMSG 6 0 nan 1 1 1 0 IMSG 1 1",
            "EXEC path takes finite floats (with IMSG 1 m, the number of way points: m + 2 points, n numbers each, then n each \
             of: vmax, amax, jmax), and float 2 of 6 is NaN",
        ),
        (
            "traj EXEC TMSG rest FMSG 6 1 0 1 1 1 0 IMSG 1 1",
            "EXEC rest takes no whole numbers (IMSG), not 1",
        ),
    ] {
        let reply = ask(&sorm, line);
        assert!(!reply.is_ok(), "{line}");
        assert_eq!(reply.reports.last().unwrap().text, expected, "{line}");
        assert!(reply.floats.is_empty() && reply.ints.is_empty());
    }
}
