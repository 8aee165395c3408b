//! Arcs, arches, blends and positions of flavors as text, with the arm of the process.

use super::*;
use nalgebra::{Matrix3, Rotation3, Vector3};

/// Where the tool is, and how it is turned.
fn tool(sorm: &Sorm) -> (Vector3<f64>, Rotation3<f64>) {
    let found = done(sorm, "mvpos EXEC where");
    let at = |row: usize, column: usize| found[6 + 4 * row + column];
    let place = Vector3::from_fn(|row, _| at(row, 3));
    (
        place,
        Rotation3::from_matrix_unchecked(Matrix3::from_fn(at)),
    )
}

/// A target beside the tool, turned as it is now: x y z roll pitch yaw.
fn beside(sorm: &Sorm, by: [f64; 3]) -> [f64; 6] {
    let (place, turn) = tool(sorm);
    let to = place + Vector3::from(by);
    let (roll, pitch, yaw) = turn.euler_angles();
    [to.x, to.y, to.z, roll, pitch, yaw]
}

/// Numbers of a request and what it says of the path.
fn along(sorm: &Sorm, form: &str, before: &[f64], target: &[f64; 6]) -> (Vec<f64>, f64) {
    let numbers = [before, target].concat();
    let reply = tell(sorm, &format!("mvpos EXEC {form} {}", angles(&numbers)));
    assert!(reply.is_ok(), "{form}: {:?}", reply.reports);
    assert_eq!(reply.floats.len(), 7);
    let value = reply.text.strip_prefix("smallest singular value ");
    (reply.floats.clone(), value.unwrap().parse().unwrap())
}

#[test]
fn arcs_and_arches_end_where_they_are_told_to_and_say_how_near_a_singularity_they_came() {
    let sorm = manager();
    tell(&sorm, "mvpos CTRL -speed 0.5");
    let by = [0.05, 0.1, -0.05];
    for (form, before) in [("arc", 3), ("about", 3), ("arch", 1)] {
        let (from, turn) = tool(&sorm);
        let target = beside(&sorm, by);
        let to = Vector3::from_column_slice(&target[..3]);
        // Beside the middle, as far from both ends.
        let aside = (to - from).cross(&Vector3::z()).normalize() * 0.08;
        let point = 0.5 * (from + to) + aside;
        let point = [point.x, point.y, point.z];
        let given = if before == 3 { &point[..] } else { &[0.04][..] };
        let (_, smallest) = along(&sorm, form, given, &target);
        assert!(smallest > 0.0 && smallest < 1.0, "{smallest}");
        let (there, turned) = tool(&sorm);
        assert!((there - to).norm() < 1e-8, "{form}");
        let off = (turned.matrix() - turn.matrix()).amax();
        assert!(off < 1e-7, "{form}: {off}");
        done(&sorm, "mvpos EXEC joints FMSG 6 0 0.8 -3 0 0.7 0");
    }
    // A straight line says it too, a motion of the joints does not.
    tell(&sorm, "mvpos CTRL -path line");
    let line = tell(&sorm, "mvpos EXEC shift FMSG 6 0.02 0 0 0 0 0");
    assert!(line.text.starts_with("smallest singular value"), "{line:?}");
    tell(&sorm, "mvpos CTRL -path joint");
    let joint = tell(&sorm, "mvpos EXEC shift FMSG 6 -0.02 0 0 0 0 0");
    assert_eq!(joint.text, "");
}

#[test]
fn the_longer_way_round_takes_longer_and_so_do_narrow_corners() {
    let sorm = manager();
    tell(&sorm, "mvpos CTRL -plan -speed 0.5");
    let (from, _) = tool(&sorm);
    let target = beside(&sorm, [0.0, 0.08, 0.0]);
    let centre = from + Vector3::new(0.0, 0.04, 0.05);
    let centre = [centre.x, centre.y, centre.z];
    let (short, _) = along(&sorm, "about", &centre, &target);
    tell(&sorm, "mvpos CTRL -longer");
    let (long, _) = along(&sorm, "about", &centre, &target);
    assert!(long[6] > short[6] + 0.1, "{short:?} {long:?}");
    near(&long[..6], &short[..6], 1e-8);
    let (wide, _) = along(&sorm, "arch", &[0.05], &target);
    tell(&sorm, "mvpos CTRL -corner 0.005");
    let (narrow, _) = along(&sorm, "arch", &[0.05], &target);
    assert!(narrow[6] > wide[6], "{narrow:?} {wide:?}");
    // The point is given in the reference frame, as the target is.
    tell(&sorm, "mvpos CTRL -reference 0 0 0.1 0 0 0");
    let lower = |numbers: &[f64]| {
        let mut numbers = numbers.to_vec();
        numbers[2] -= 0.1;
        numbers
    };
    let target: [f64; 6] = lower(&target).try_into().unwrap();
    let (same, _) = along(&sorm, "about", &lower(&centre), &target);
    assert!((same[6] - long[6]).abs() < 1e-6);
}

#[test]
fn what_is_no_arc_or_no_arch_is_refused_in_words() {
    let sorm = manager();
    let target = beside(&sorm, [0.0, 0.1, 0.0]);
    let (from, _) = tool(&sorm);
    let refused = |form: &str, before: &[f64], target: &[f64; 6]| {
        let numbers = [before, target].concat();
        let reply = tell(&sorm, &format!("mvpos EXEC {form} {}", angles(&numbers)));
        assert!(!reply.is_ok() && reply.floats.is_empty() && reply.text.is_empty());
        reply.reports.last().unwrap().text.clone()
    };
    let middle = [from.x, from.y + 0.05, from.z];
    let text = refused("arc", &middle, &target);
    assert!(text.contains("one straight line"), "{text}");
    let text = refused("about", &[from.x, from.y + 0.02, from.z], &target);
    assert!(text.contains("as far from both"), "{text}");
    let text = refused("arch", &[-0.1], &target);
    assert!(text.contains("above 0 m"), "{text}");
    let above = beside(&sorm, [0.0, 0.0, 0.1]);
    let text = refused("arch", &[0.1], &above);
    assert!(text.contains("right above or below"), "{text}");
    let text = refused("arch", &[3.0], &target);
    assert!(text.contains("% of its length"), "{text}");
}

#[test]
fn a_blend_by_a_radius_saves_time_and_a_wider_one_saves_more() {
    let sorm = manager();
    let (a, b) = ("0.4 0.9 -2.4 0 0.6 0", "0.8 0.5 -2.6 0.3 0.2 0");
    let how_long = |options: &str| {
        tell(&sorm, &format!("mvpos CTRL -plan {options}"));
        done(&sorm, &format!("mvpos EXEC along FMSG 12 {a} {b}"))[6]
    };
    for by in ["radius", "joints"] {
        let [stop, narrow, wide] =
            ["0", "0.05", "0.3"].map(|blend| how_long(&format!("-blendBy {by} -blend {blend}")));
        assert!(
            stop > narrow + 1e-3 && narrow > wide + 1e-3,
            "{stop} {narrow} {wide}"
        );
    }
}

#[test]
fn a_flavors_position_has_as_many_numbers_as_are_given_and_is_shown_as_it_was() {
    let sorm = manager();
    let told = tell(
        &sorm,
        "mvpos.shelf CTRL -speed 0.5 -to 0.1 0.8 -1.5 0 -0.7 0.2 -plan",
    );
    assert!(told.is_ok(), "{:?}", told.reports);
    near(
        &done(&sorm, "mvpos.shelf EXEC")[..6],
        &[0.1, 0.8, -1.5, 0.0, -0.7, 0.2],
        1e-12,
    );
    let dump = tell(&sorm, "mvpos.shelf CTRL -dump").text;
    assert!(dump.contains("-to 0.1 0.8 -1.5 0.0 -0.7 0.2"), "{dump}");
    assert!(tell(&sorm, &format!("mvpos.again CTRL {dump}")).is_ok());
    near(
        &done(&sorm, "mvpos.again EXEC")[..6],
        &[0.1, 0.8, -1.5, 0.0, -0.7, 0.2],
        1e-12,
    );
    tell(&sorm, "mvpos.nine CTRL -to 0 0 0 0.1 0.8 -1.5 0 0.7 0.2");
    let reply = tell(&sorm, "mvpos.nine EXEC");
    let text = &reply.reports.last().unwrap().text;
    assert!(
        text.contains("6 joints, and the target has 9 positions"),
        "{text}"
    );
    for wrong in ["-to", "-to -speed 0.5", "-to 0.1 high"] {
        assert!(
            !tell(&sorm, &format!("mvpos.wrong CTRL {wrong}")).is_ok(),
            "{wrong}"
        );
    }
}

#[test]
fn a_path_planner_is_asked_for_by_its_name() {
    let sorm = manager();
    let target = beside(&sorm, [0.05, 0.1, 0.0]);
    tell(&sorm, "mvpos CTRL -plan -planner arch -with 0.05");
    let named = done(&sorm, &format!("mvpos EXEC place {}", angles(&target)));
    tell(&sorm, "mvpos CTRL -planner ''");
    let (arch, _) = along(&sorm, "arch", &[0.05], &target);
    near(&named, &arch, 1e-12);
    tell(&sorm, "mvpos CTRL -planner guess");
    let reply = tell(&sorm, &format!("mvpos EXEC place {}", angles(&target)));
    let text = &reply.reports.last().unwrap().text;
    assert!(text.contains("no path planner `guess`"), "{text}");
}
