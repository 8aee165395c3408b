//! Parts that go missing while nobody moves the arm, and come back.

use sorma::snapshot::{Layout, Place, Writer};

use super::*;

fn must_succeed(outcome: &boot::Outcome) {
    let ok = matches!(&outcome.end, End::Finished(result) if result.ok);
    assert!(ok, "{:?}", outcome.end);
}

#[test]
fn a_driver_that_fails_while_the_arm_is_cold_is_named_to_who_reserves_or_resets_until_it_is_back() {
    let script: Script = |cx, mcs, knobs| {
        Box::pin(async move {
            let a_tick = Duration::from_millis(20);
            // Before anybody had it, and after somebody gave it back.
            for round in 0..2 {
                // It fails to read, or reads no number.
                for fault in [1, 3] {
                    knobs.fault.store(fault, Ordering::Relaxed);
                    let writes = knobs.writes_under_power.load(Ordering::Relaxed);
                    cx.sleep(a_tick).await;
                    let words = if fault == 3 {
                        "joint 5 reads as no finite number"
                    } else {
                        "cable out"
                    };
                    let acquire = error_of(&cx, &mcs, Acquire {}).await?;
                    assert_eq!(acquire.outcome, Outcome::Fault, "{acquire}");
                    let reset = error_of(&cx, &mcs, Reset {}).await?;
                    let moved = error_of(&cx, &mcs, to(Target::Joints(GOAL.into()))).await?;
                    for told in [acquire, reset, moved] {
                        assert!(told.reason.contains(words), "{round} {fault}: {told}");
                    }
                    let status = asked(&cx, &mcs, Status {}).await?;
                    assert_eq!((status.state, status.holder), (State::Estopped, None));
                    assert_eq!(knobs.writes_under_power.load(Ordering::Relaxed), writes);
                    knobs.fault.store(0, Ordering::Relaxed);
                    // It is back, and nothing moves by itself.
                    cx.sleep(a_tick).await;
                    let again = error_of(&cx, &mcs, Acquire {}).await?;
                    assert!(again.reason.contains("reset it"), "{again}");
                    assert_eq!(done(&cx, &mcs, Reset {}).await?, State::Cold);
                }
                done(&cx, &mcs, Acquire {}).await?;
                done(&cx, &mcs, to(Target::Joints(GOAL.into()))).await?;
                done(&cx, &mcs, Release {}).await?;
            }
            Ok(String::new())
        })
    };
    must_succeed(&run(script, &Arc::default(), &[]));
}

#[test]
fn while_a_slot_reads_nothing_nobody_reserves_the_arm_and_is_told_which_one() {
    let buffer = || format!("missing_door_{}", std::process::id());
    let parts = format!(
        "task.servo.args.driver_args.parts=[{{ driver = \"test.arm\" }}, {{ driver = \"mcs.slots\", driver_args = \
         {{ slots = [{{ name = \"door\", kind = \"digital_input\", buffer = \"{}\" }}] }} }}]",
        buffer()
    );
    let script: Script = |cx, mcs, _| {
        Box::pin(async move {
            let place = Place::of_app(&cx.app().name)?;
            let clock = cx.chassis().clock().clone();
            let name = format!("missing_door_{}", std::process::id());
            let refused = async || {
                let told = error_of(&cx, &mcs, Acquire {}).await?;
                assert_eq!(told.outcome, Outcome::Refused, "{told}");
                assert!(told.reason.contains("slot `door` reads nothing"), "{told}");
                let status = asked(&cx, &mcs, Status {}).await?;
                assert_eq!((status.state, status.holder), (State::Cold, None));
                Ok::<(), HandlerError>(())
            };
            // It was never there; then it is, twice; then it falls silent; then it is gone.
            refused().await?;
            for _ in 0..2 {
                let mut door = Writer::create(&place, &name, Layout::new(4, 1), &clock)?;
                for _ in 0..20 {
                    door.write(&[1.0], &[])?;
                    cx.sleep(Duration::from_millis(20)).await;
                }
                done(&cx, &mcs, Acquire {}).await?;
                door.write(&[1.0], &[])?;
                done(&cx, &mcs, Release {}).await?;
                cx.sleep(Duration::from_millis(150)).await;
                refused().await?;
                drop(door);
                refused().await?;
            }
            Ok(String::new())
        })
    };
    must_succeed(&run(
        script,
        &Arc::default(),
        &["task.servo.args.driver=mcs.testbed", &parts],
    ));
}
