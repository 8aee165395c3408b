//! What there is to see of the testbed: each arm where the kinematics of the whole has it, and the distances that its guards keep.

use std::collections::BTreeMap;

use mcs::model::{Model, file::Inertias, origin::Origin};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use rustix::process::Signal;
use serde_json::Value;

use crate::harness::{CTOS, Scratch};

/// What one task showed last: its parts, and the row of each.
#[derive(Default)]
struct Shown {
    parts: Vec<Value>,
    rows: BTreeMap<u64, Vec<f64>>,
    said: Vec<String>,
}

/// Boots `configs/PARTITION`, asks for what `lines` say, one after the other, and reads what the record has of the scene.
fn shown(partition: &str, lines: &[&str]) -> BTreeMap<String, Shown> {
    let scratch = Scratch::new();
    let boot = ["boot", partition, "--record", "run.mcap"];
    let mut run = scratch.start(CTOS, &boot, &[]);
    run.wait_for("phase 3");
    for line in lines {
        let ended = scratch.scott(&["testbed", "-c", line]);
        ended.must_exit_leaving(0);
    }
    run.signal(Signal::INT);
    run.end();
    // It is shown without a net, too.
    let export = ["display", "run.mcap", "--export", "run.html"];
    scratch.ctos(&export).must_exit(0);
    assert!(scratch.read("run.html").contains("\"kind\":\"scene\""));
    let cat = ["log", "cat", "run.mcap", "--topic", "/scene/*", "--json"];
    let mut all: BTreeMap<String, Shown> = BTreeMap::new();
    for entry in scratch.ctos(&cat).json_lines() {
        let topic = entry["topic"].as_str().unwrap();
        let task = topic.strip_prefix("/scene/").unwrap().to_owned();
        let (known, step) = (all.entry(task).or_default(), &entry["line"]);
        if let Some(parts) = step["view"]["parts"].as_array() {
            *known = Shown {
                parts: parts.clone(),
                said: std::mem::take(&mut known.said),
                ..Shown::default()
            };
        }
        for row in step["moved"].as_array().unwrap() {
            let row = row.as_array().unwrap().iter();
            let row: Vec<f64> = row.map(|one| one.as_f64().unwrap_or(f64::NAN)).collect();
            known.rows.insert(row[0] as u64, row);
        }
        let said = step["said"]["words"].as_str();
        known.said.extend(said.map(str::to_owned));
    }
    all
}

fn testbed18() -> Model {
    let origin = Origin::named("testbed18");
    let loaded = origin.load(None, None, Inertias::Engine);
    loaded.unwrap_or_else(|wrong| panic!("{wrong}")).model
}

/// Holds that all links are where the kinematics of all eighteen joints puts them. `named` gives a part's name in the whole.
#[track_caller]
fn must_stand_as_a_whole(
    all: &BTreeMap<String, Shown>,
    named: impl Fn(&str, &str) -> Option<String>,
) {
    let mut rows = BTreeMap::new();
    for (task, shown) in all {
        for (part, index) in shown.parts.iter().zip(0..) {
            let name = named(task, part["name"].as_str().unwrap());
            if let (Some(name), "link", Some(row)) =
                (name, part["kind"].as_str().unwrap(), shown.rows.get(&index))
            {
                rows.insert(name, row);
            }
        }
    }
    let model = testbed18();
    let link = |joint: usize| {
        let mut frames = model.frames().iter();
        let frame = frames.find(|frame| frame.carrier == Some(joint)).unwrap();
        frame.name.clone()
    };
    let links: Vec<String> = (0..model.dof()).map(link).collect();
    let row = |link: &String| rows.get(link).unwrap_or_else(|| panic!("{link}: {rows:?}"));
    let joints: Vec<f64> = links.iter().map(|link| row(link)[8]).collect();
    let moved = joints.iter().filter(|joint| joint.abs() > 0.05).count();
    assert!(moved >= 10, "{joints:?}");
    let mut data = model.data();
    model.forward(&mut data, &joints);
    for (joint, link) in links.iter().enumerate() {
        let (there, row) = (data.carrier(Some(joint)).isometry(), row(link));
        let off = there.translation.vector - Vector3::new(row[1], row[2], row[3]);
        assert!(off.norm() < 2e-4, "{link} is {} m off", off.norm());
        let turn = Quaternion::new(row[7], row[4], row[5], row[6]);
        let turned = there
            .rotation
            .angle_to(&UnitQuaternion::from_quaternion(turn));
        assert!(turned < 2e-4, "{link} is {turned} rad off");
    }
}

/// `arm.link1` of the left one is `left_arm.link1`; of an arm alone it is `link1`.
fn sided(task: &str, part: &str) -> Option<String> {
    let side = task.strip_prefix("state_")?;
    Some(match (side, part.contains('.')) {
        ("left" | "right", true) => format!("{side}_{part}"),
        ("left" | "right", false) => format!("{side}_arm.{part}"),
        _ => part.to_owned(),
    })
}

#[test]
fn arms_and_transporters_of_three_programs_are_seen_where_the_kinematics_of_all_joints_puts_them() {
    let moves = [
        "mvpos.carts EXEC by FMSG 6 0.3 0.4 0.1 -0.2 -0.3 0.15",
        "mvpos.left EXEC by FMSG 6 0.4 0.1 0 0.2 0 0.2",
        "mvpos.right EXEC by FMSG 6 -0.3 0.2 0 0.3 0 -0.2",
    ];
    must_stand_as_a_whole(&shown("configs/testbed.toml", &moves), sided);
}

#[test]
fn two_manipulators_of_nine_joints_are_seen_side_by_side() {
    let moves = [
        "mvpos.left EXEC by FMSG 9 0.3 0.4 0.1 0.4 0.1 0 0.2 0 0.2",
        "mvpos.right EXEC by FMSG 9 -0.2 -0.3 0.15 -0.3 0.2 0 0.3 0 -0.2",
    ];
    must_stand_as_a_whole(&shown("configs/testbed-2x9.toml", &moves), sided);
}

#[test]
fn one_manipulator_of_eighteen_joints_is_seen_as_a_whole() {
    let moves = [
        "mvpos.both EXEC by FMSG 18 0.3 0.4 0.1 0.4 0.1 0 0.2 0 0.2 -0.2 -0.3 0.15 -0.3 0.2 0 0.3 0 -0.2",
    ];
    let whole = |_: &str, part: &str| Some(part.to_owned());
    must_stand_as_a_whole(&shown("configs/testbed-1x18.toml", &moves), whole);
}

#[test]
fn the_margin_that_a_guard_keeps_and_what_is_nearest_are_seen_and_told() {
    // Down to where the hand is near the floor.
    let moves = ["mvpos.left EXEC by FMSG 9 0.1 0 0 0 0.9 0 0 0 0"];
    let all = shown("configs/testbed-collision.toml", &moves);
    let left = &all["state_left"];
    let part = |name: &str| {
        let found = left.parts.iter().position(|part| part["name"] == name);
        let at = found.unwrap_or_else(|| panic!("no `{name}`: {:?}", left.parts));
        (&left.parts[at], &left.rows[&(at as u64)])
    };
    let mut margins = 0;
    for grown in left.parts.iter().filter(|part| part["kind"] == "margin") {
        let (own, _) = part(grown["parent"].as_str().unwrap());
        let both = own["solids"].as_array().unwrap().iter();
        for (own, grown) in both.zip(grown["solids"].as_array().unwrap()) {
            let size = |solid: &Value| {
                let round = solid["capsule"]["radius"].as_f64();
                round
                    .or_else(|| solid["block"]["half"][0].as_f64())
                    .unwrap()
            };
            assert!(
                (size(grown) - size(own) - 0.02).abs() < 1e-9,
                "{own} {grown}"
            );
            margins += 1;
        }
    }
    assert!(margins > 8, "{margins}");
    // The distance is that of both ends, of which one is on the floor if that is nearest.
    let (nearest, row) = part("collision nearest");
    assert_eq!(nearest["kind"], "nearest");
    let [distance, x, y, z] = row[8..12] else {
        panic!("{row:?}");
    };
    assert!(
        (Vector3::new(x, y, z).norm() - distance).abs() < 1e-3,
        "{row:?}"
    );
    let near = left.said.iter().any(|said| said.contains(" is near "));
    assert_eq!(near, distance < 0.1, "{:?} {row:?}", left.said);
}
