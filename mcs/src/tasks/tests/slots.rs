//! Slots that are no joints, named in the configuration beside an arm: a lamp, a laser pointer, a switch and a space mouse.

use sorma::snapshot::{Layout, Place, Reader, Snapshot, Writer};

use super::*;

/// Buffers of this process alone: tests of one app's name run at once.
fn buffer(name: &str) -> String {
    format!("slot_{name}_{}", std::process::id())
}

/// The arm of the tests with four slots beside it.
fn beside() -> [String; 2] {
    let slot = |name: &str, kind: &str| {
        let buffer = buffer(name);
        format!("{{ name = \"{name}\", kind = \"{kind}\", buffer = \"{buffer}\" }}")
    };
    let slots = [
        slot("lamp", "lamp"),
        slot("pointer", "laser"),
        slot("door", "digital_input"),
        slot("mouse", "space_mouse"),
    ];
    let parts = format!(
        "[{{ driver = \"test.arm\" }}, {{ driver = \"mcs.slots\", driver_args = {{ slots = [{}] }} }}]",
        slots.join(", ")
    );
    [
        "task.servo.args.driver=mcs.testbed".to_owned(),
        format!("task.servo.args.driver_args.parts={parts}"),
    ]
}

#[test]
fn slots_beside_joints_are_read_set_by_the_owner_and_stop_the_arm_when_they_fall_silent() {
    let script: Script = |cx, mcs, _| {
        Box::pin(async move {
            let place = Place::of_app(&cx.app().name)?;
            let clock = cx.chassis().clock().clone();
            let missing = told(&cx, "pino EXEC sensors").await?;
            let expected =
                "lamp Lamp, pointer Laser, door DigitalInput (stale), mouse SpaceMouse (stale)";
            assert_eq!(missing.text, expected);
            let state = cx.task("state").await?;
            // What viewers are told of the slots: nothing of those that read nothing.
            let shown = async || {
                let follow = scene::FollowScene {
                    after: None,
                    patience_ms: 0,
                };
                let batch = asked(&cx, &state, follow).await?;
                let tool = batch.moved.last().map(|tool| tool.numbers.clone());
                let view = batch.view.unwrap_or_default();
                let numbers = view.parts.last().map(|tool| tool.numbers.clone());
                let named = numbers.unwrap_or_default().into_iter();
                let named = named
                    .map(|number| number.name)
                    .zip(tool.unwrap_or_default());
                Ok::<Vec<(String, f64)>, HandlerError>(named.collect())
            };
            let before = shown().await?;
            assert_eq!((before[0].0.as_str(), before[0].1), ("lamp", 0.0));
            assert_eq!(before[2].0, "door");
            assert!(before[2].1.is_nan() && before[8].1.is_nan(), "{before:?}");
            let mut door = Writer::create(&place, &buffer("door"), Layout::new(4, 1), &clock)?;
            let mut mouse = Writer::create(&place, &buffer("mouse"), Layout::new(4, 6), &clock)?;
            for _ in 0..20 {
                door.write(&[1.0], &[])?;
                mouse.write(&[0.1, 0.2, 0.3, 0.4, 0.5, 0.6], &[])?;
                cx.sleep(Duration::from_millis(20)).await;
            }
            let there = told(&cx, "pino EXEC sensors").await?;
            let expected = "lamp Lamp, pointer Laser, door DigitalInput, mouse SpaceMouse";
            assert_eq!(there.text, expected);
            let numbers = [0.0, 0.0, 1.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6];
            assert_eq!(there.floats, numbers);
            let after = shown().await?;
            assert!(
                after.iter().map(|(_, value)| *value).eq(numbers),
                "{after:?}"
            );
            assert_eq!(after[8].0, "mouse about z");
            // Only its holder sets a slot, and by what it takes.
            let output = |name: &str, value: f64| SetOutput {
                name: name.to_owned(),
                value,
            };
            let nobody = refusal(&cx, &mcs, output("lamp", 0.5)).await?;
            assert!(
                nobody.contains("reserved by nobody; acquire it first"),
                "{nobody}"
            );
            done(&cx, &mcs, Acquire {}).await?;
            let other = told(&cx, "pino EXEC output lamp FMSG 1 1").await?;
            let text = &other.reports[0].text;
            assert!(text.contains("reserved by task `user`"), "{text}");
            for (request, expected) in [
                (
                    output("lmap", 1.0),
                    "there is no output `lmap`; there are: lamp, pointer",
                ),
                (output("door", 1.0), "slot `door` is read, and not set"),
                (
                    output("pointer", 0.5),
                    "output `pointer` is set to 0 or 1, not 0.5",
                ),
                (
                    output("lamp", f64::NAN),
                    "output `lamp` is set to 0 to 1, not NaN",
                ),
            ] {
                let refused = refusal(&cx, &mcs, request).await?;
                assert_eq!(refused, expected);
            }
            done(&cx, &mcs, output("lamp", 0.5)).await?;
            done(&cx, &mcs, output("pointer", 1.0)).await?;
            cx.sleep(Duration::from_millis(20)).await;
            let mut lamp = Reader::open(&place, &buffer("lamp"))?;
            let mut record = Snapshot::default();
            lamp.latest(&mut record)?;
            assert_eq!(record.floats, [0.5]);
            // The mouse falls silent on the way.
            let own = cx.clone();
            let moving = done(&own, &mcs, to(Target::Joints(GOAL.into())));
            let feeding = async {
                for step in 0..60 {
                    door.write(&[1.0], &[])?;
                    if step < 15 {
                        mouse.write(&[0.0; 6], &[])?;
                    }
                    cx.sleep(Duration::from_millis(20)).await;
                }
                Ok::<(), HandlerError>(())
            };
            let (moved, fed) = futures_util::future::join(moving, feeding).await;
            fed?;
            let told_why = moved.expect_err("it went on").to_string();
            assert!(
                told_why.contains("guard `slots` ended it: what slot `mouse` reads is"),
                "{told_why}"
            );
            door.write(&[1.0], &[])?;
            cx.sleep(Duration::from_millis(20)).await;
            let again = refusal(&cx, &mcs, to(Target::Joints(GOAL.into()))).await?;
            assert!(again.contains("a slot of the arm is stale"), "{again}");
            done(&cx, &mcs, Release {}).await?;
            cx.sleep(Duration::from_millis(20)).await;
            lamp.latest(&mut record)?;
            assert_eq!(record.floats, [0.0], "it is off with the power");
            Ok(String::new())
        })
    };
    let sets = beside();
    let sets = sets.each_ref().map(String::as_str);
    let outcome = run(script, &Arc::default(), &sets);
    assert!(
        matches!(&outcome.end, End::Finished(result) if result.ok),
        "{:?}",
        outcome.end
    );
}

#[test]
fn wrong_slots_and_modes_are_found_before_anything_starts() {
    let parts = |args: &str| {
        let parts = format!(
            "task.servo.args.driver_args.parts=[{{ driver = \"test.arm\" }}, {{ driver = \"mcs.slots\", driver_args = {args} }}]"
        );
        findings_of(&["task.servo.args.driver=mcs.testbed", &parts])
    };
    let fine = parts("{ slots = [{ name = \"a\", kind = \"hand_joint\" }] }");
    assert_eq!(fine, "");
    let twice =
        "{ slots = [{ name = \"a\", kind = \"lamp\" }, { name = \"a\", kind = \"laser\" }] }";
    let twice = parts(twice);
    assert!(
        twice.contains("two slots of task `servo` are called `a`"),
        "{twice}"
    );
    let kind = parts("{ slots = [{ name = \"a\", kind = \"lazer\" }] }");
    assert!(kind.contains("lazer"), "{kind}");
    let drives = |args: &str| {
        let args = format!("task.servo.args.driver_args={args}");
        findings_of(&["task.servo.args.driver=mcs.drives", &args])
    };
    assert_eq!(drives("{ driver = \"test.arm\", modes = [\"csp\"] }"), "");
    let count = drives("{ driver = \"test.arm\", modes = [\"csp\", \"cst\"] }");
    assert!(
        count.contains("`modes` has 2 entries for 6 slots"),
        "{count}"
    );
    let driver = drives("{ driver = \"test.amr\", modes = [\"csp\"] }");
    assert!(driver.contains("did you mean `test.arm`?"), "{driver}");
}

#[test]
fn an_arm_whose_drives_take_positions_is_moved_by_the_same_requests() {
    let script: Script = |cx, mcs, _| {
        Box::pin(async move {
            done(&cx, &mcs, Acquire {}).await?;
            let report = done(&cx, &mcs, to(Target::Joints(GOAL.into()))).await?;
            assert!(report.max_tracking_error_rad < 4e-3, "{report:?}");
            Ok(String::new())
        })
    };
    let sets = [
        "task.servo.args.driver=mcs.drives",
        "task.servo.args.driver_args={ driver = \"test.arm\", modes = [\"csp\"] }",
    ];
    let outcome = run(script, &Arc::default(), &sets);
    assert!(
        matches!(&outcome.end, End::Finished(result) if result.ok),
        "{:?}",
        outcome.end
    );
}
