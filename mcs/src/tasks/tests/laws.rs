//! Laws by name, in the configuration and while the app runs.

use super::*;

#[test]
fn a_law_is_changed_on_the_way_and_the_arm_arrives() {
    let text = text_of(|cx, mcs, _| {
        Box::pin(async move {
            done(&cx, &mcs, Acquire {}).await?;
            let change = async {
                cx.sleep(Duration::from_millis(300)).await;
                told(&cx, "pino EXEC law computed_torque").await
            };
            let moving = done(&cx, &mcs, to(Target::Joints(GOAL.into())));
            let (changed, moved) = futures_util::future::join(change, moving).await;
            assert_eq!(changed?.text, "computed_torque");
            let first = moved?;
            let control = asked(&cx, &mcs, ReadControl {}).await?;
            assert_eq!(control.law, "computed_torque");
            let back = done(&cx, &mcs, to(Target::Joints(START.into()))).await?;
            // The whole way with the better law.
            assert!(back.max_tracking_error_rad < first.max_tracking_error_rad / 5.0);
            let law = "computd_torque".to_owned();
            let refused = asked(&cx, &mcs, SetLaw { law }).await.unwrap_err();
            let control = asked(&cx, &mcs, ReadControl {}).await?;
            assert_eq!(control.law, "computed_torque");
            Ok(refused.to_string())
        })
    });
    assert!(
        text.contains("`computd_torque`, which nobody registered"),
        "{text}"
    );
}

#[test]
fn the_arguments_of_other_laws_are_checked_and_are_theirs() {
    let soft = "task.servo.args.laws.joint_impedance.stiffness=[50,50,50,20,20,20]";
    let outcome = run(
        |cx, mcs, _| {
            Box::pin(async move {
                done(&cx, &mcs, Acquire {}).await?;
                let law = "joint_impedance".to_owned();
                Ok(asked(&cx, &mcs, SetLaw { law }).await?.law)
            })
        },
        &Arc::default(),
        &[soft],
    );
    assert!(matches!(outcome.end, End::Finished(result) if result.ok));
    let findings = |set: &str| {
        let app = ctos::config::load_texts(&[("app.toml", APP)], &[set.to_owned()], &[]).unwrap();
        registry(
            |_, _, _| Box::pin(async { Ok(String::new()) }),
            &Arc::default(),
        )
        .check(&app)
        .to_string()
    };
    let few = findings("task.servo.args.laws.joint_impedance.stiffness=[50]");
    assert!(few.contains("`stiffness` has 1 numbers"), "{few}");
    let unknown = findings("task.servo.args.laws.impedance.stiffness=[50]");
    assert!(
        unknown.contains("the control law `impedance`, which nobody registered"),
        "{unknown}"
    );
    let gain = findings("task.servo.args.laws.cartesian_impedance.force_gain=9.0");
    assert!(gain.contains("`force_gain` is 9"), "{gain}");
}

/// An app whose law has its other half on this processor of the servo's chassis.
fn split_on(processor: &str) -> String {
    format!(
        "{APP}[task.half]\nhandler = \"mcs.split_torque\"\non = \"cage/{processor}\"\nargs.servo = \"servo\"\n\
         [chassis.cage.processors.second]\n"
    )
}

const SPLIT: &str = "task.servo.args.law=split_torque";

#[test]
fn a_law_on_two_processors_moves_the_arm_as_on_one_to_the_bit() {
    let moved = |processor: &str, seed: u64| {
        let seed = format!("app.seed={seed}");
        let outcome = run_in(
            &split_on(processor),
            |cx, mcs, _| {
                Box::pin(async move {
                    done(&cx, &mcs, Acquire {}).await?;
                    let report = done(&cx, &mcs, to(Target::Joints(GOAL.into()))).await?;
                    assert!(report.max_tracking_error_rad < 4e-4, "{report:?}");
                    let position = asked(&cx, &mcs, ReadPosition {}).await?;
                    Ok(format!("{report:?} {:?}", position.joints))
                })
            },
            &Arc::default(),
            &[SPLIT, &seed],
        );
        match outcome.end {
            End::Finished(result) if result.ok => result.text,
            other => panic!("{other:?}"),
        }
    };
    let alone = moved("servo", 1);
    for seed in [1, 2, 3] {
        assert_eq!(alone, moved("second", seed), "seed {seed}");
    }
}

#[test]
fn a_law_on_two_processors_without_its_other_half_is_found_before_anything_starts() {
    let split = split_on("second");
    assert_eq!(findings_in(&split, &[SPLIT]), "");
    let found = findings_of(&[SPLIT]);
    assert!(
        found.contains("the law of task `servo` has no other half")
            && found.contains("`handler = \"mcs.split_torque\"`"),
        "{found}"
    );
    let found = findings_in(&split, &["task.half.args.servo=sevro"]);
    assert!(found.contains("did you mean `servo`?"), "{found}");
    let found = findings_in(&split, &["task.half.on=ws"]);
    assert!(found.contains("must be on one chassis"), "{found}");
}
