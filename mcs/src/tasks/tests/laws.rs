//! Laws by name, in the configuration and while the app runs.

use ctos::system::Shutdown;

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
        let knobs = Arc::<Knobs>::default();
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
            &knobs,
            &[SPLIT, &seed],
        );
        let torques = std::mem::take(&mut *knobs.torques.lock().unwrap());
        match outcome.end {
            End::Finished(result) if result.ok => (result.text, torques),
            other => panic!("{other:?}"),
        }
    };
    let (told, torques) = moved("servo", 1);
    // A motion of more than a second at 4.5 ms, and the torques change from tick to tick.
    assert!(torques.windows(2).filter(|pair| pair[0] != pair[1]).count() > 222);
    for seed in [1, 2, 3] {
        let (as_told, others) = moved("second", seed);
        assert_eq!(told, as_told, "seed {seed}");
        // How long the arm is held after its motion is the clients' matter.
        let both = torques.iter().zip(&others);
        let other = both.enumerate().find(|(_, (one, other))| one != other);
        assert_eq!(other, None, "seed {seed}");
        assert!(torques.len().abs_diff(others.len()) < 20, "seed {seed}");
    }
}

#[test]
fn a_law_whose_other_half_ends_in_mid_motion_stops_the_arm_and_who_moved_it_is_told_why() {
    let outcome = run_in(
        &split_on("second"),
        |cx, mcs, knobs| {
            Box::pin(async move {
                let half = cx.task("half").await?;
                done(&cx, &mcs, Acquire {}).await?;
                let ended = async {
                    cx.sleep(Duration::from_millis(300)).await;
                    asked(&cx, &half, Shutdown {}).await
                };
                let moving = error_of(&cx, &mcs, to(Target::Joints(GOAL.into())));
                let (ended, told) = futures_util::future::join(ended, moving).await;
                ended?;
                let told = told?;
                assert_eq!(told.outcome, Outcome::Fault, "{told}");
                let why = "its half on the other processor has not answered";
                assert!(told.reason.contains(why), "{told}");
                let stands = async || {
                    let (power, _) = knobs.last_write.lock().unwrap().unwrap();
                    assert_eq!(power, Power::Off);
                    let position = asked(&cx, &mcs, ReadPosition {}).await?;
                    Ok::<Joints, HandlerError>(position.joints)
                };
                let stopped = stands().await?;
                assert!((stopped[0] - GOAL[0]).abs() > 0.05, "{stopped:?}");
                let refused = error_of(&cx, &mcs, Acquire {}).await?;
                assert!(refused.reason.contains(why), "{refused}");
                // It is still gone: who tries again is told again, and the arm has hardly moved.
                assert_eq!(done(&cx, &mcs, Reset {}).await?, State::Cold);
                done(&cx, &mcs, Acquire {}).await?;
                let again = error_of(&cx, &mcs, to(Target::Joints(GOAL.into()))).await?;
                assert!(again.reason.contains(why), "{again}");
                let later = stands().await?;
                let off = stopped.iter().zip(&later).map(|(a, b)| (a - b).abs());
                assert!(off.fold(0.0, f64::max) < 2e-3, "{stopped:?} {later:?}");
                Ok(String::new())
            })
        },
        &Arc::default(),
        &[SPLIT],
    );
    assert!(
        matches!(&outcome.end, End::Finished(result) if result.ok),
        "{:?}",
        outcome.end
    );
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
