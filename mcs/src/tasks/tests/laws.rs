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
