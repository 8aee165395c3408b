//! What ends a motion before its end, what is told of it, and how it goes on: stops, a held joint, and the
//! loss of chassis that the motion needs or does not.

use ctos::simulation::{self, Fault, FaultKind, Faults, Setup};
use ctos::time::Instant;

use super::*;
use crate::client::Outcome as MotionOutcome;
use crate::servo::{MotionPhase, ServoCommand};

/// Moves to the goal and asks for something else in the midst of it; what the mover was told.
async fn disturbed<T, C: Command<Reply = T>>(
    cx: &Context,
    mcs: &TaskRef,
    request: C,
) -> Result<MotionError, HandlerError> {
    let disturb = async {
        cx.sleep(Duration::from_millis(300)).await;
        asked(cx, mcs, request).await
    };
    let moving = error_of(cx, mcs, to(Target::Joints(GOAL.into())));
    let (disturbed, moved) = futures_util::future::join(disturb, moving).await;
    disturbed?;
    moved
}

#[test]
fn a_protective_stop_holds_through_release_and_acquisition_until_somebody_resumes() {
    text_of(|cx, mcs, _| {
        Box::pin(async move {
            done(&cx, &mcs, Acquire {}).await?;
            let told = disturbed(&cx, &mcs, Stop {}).await?;
            assert_eq!(told.outcome, Outcome::Stopped);
            assert!(told.reason.contains("protective stop"), "{told}");
            let stands = asked(&cx, &mcs, ReadPosition {}).await?;
            assert!(stands.at_rest);
            assert!((stands.joints[0] - GOAL[0]).abs() > 0.01);
            // At once, later, and for whoever comes next.
            for _ in 0..3 {
                assert!(asked(&cx, &mcs, Status {}).await?.stopped);
                let again = error_of(&cx, &mcs, to(Target::Joints(GOAL.into()))).await?;
                assert_eq!(again.outcome, Outcome::Stopped);
                assert!(again.reason.contains("resume"), "{again}");
                done(&cx, &mcs, Release {}).await?;
                cx.sleep(Duration::from_secs(10)).await;
                done(&cx, &mcs, Acquire {}).await?;
            }
            let later = asked(&cx, &mcs, ReadPosition {}).await?;
            for (now, then) in later.joints.iter().zip(&stands.joints) {
                assert!((now - then).abs() < 1e-3);
            }
            asked(&cx, &mcs, Resume {}).await?;
            assert!(!asked(&cx, &mcs, Status {}).await?.stopped);
            done(&cx, &mcs, to(Target::Joints(GOAL.into()))).await?;
            Ok(String::new())
        })
    });
}

#[test]
fn who_watches_is_told_of_every_joint_with_its_limits_and_why_the_arm_was_stopped_last() {
    text_of(|cx, mcs, _| {
        Box::pin(async move {
            let stop = async |words: &str| -> Result<(), HandlerError> {
                let slots = asked(&cx, &mcs, ReadSlots {}).await?;
                assert_eq!(slots.last_stop.unwrap_or_default(), words);
                Ok(())
            };
            stop("").await?;
            done(&cx, &mcs, Acquire {}).await?;
            disturbed(&cx, &mcs, Stop {}).await?;
            stop("a protective stop was asked for").await?;
            let stands = asked(&cx, &mcs, ReadPosition {}).await?;
            let slots = asked(&cx, &mcs, ReadSlots {}).await?;
            assert_eq!(slots.joints.len(), 6);
            for (joint, position) in slots.joints.iter().zip(&stands.joints) {
                assert!((joint.position - position).abs() < 1e-3, "{joint:?}");
                assert!((joint.setpoint - position).abs() < 1e-2, "{joint:?}");
                let [lower, upper] = joint.range;
                assert!(lower < *position && *position < upper, "{joint:?}");
                assert!(joint.most_torque.is_finite() && joint.torque.abs() <= joint.most_torque);
            }
            // What ended it is told of after it has ended, too.
            asked(&cx, &mcs, Resume {}).await?;
            stop("a protective stop was asked for").await?;
            asked(&cx, &mcs, EmergencyStop {}).await?;
            done(&cx, &mcs, Reset {}).await?;
            stop("emergency stop was asked for").await?;
            Ok(String::new())
        })
    });
}

#[test]
fn a_stop_of_an_arm_that_stands_holds_too_and_a_reset_ends_it() {
    text_of(|cx, mcs, _| {
        Box::pin(async move {
            asked(&cx, &mcs, Stop {}).await?;
            done(&cx, &mcs, Acquire {}).await?;
            let told = error_of(&cx, &mcs, to(Target::Joints(GOAL.into()))).await?;
            assert_eq!(told.outcome, Outcome::Stopped);
            asked(&cx, &mcs, EmergencyStop {}).await?;
            cx.sleep(Duration::from_millis(20)).await;
            done(&cx, &mcs, Reset {}).await?;
            done(&cx, &mcs, Acquire {}).await?;
            done(&cx, &mcs, to(Target::Joints(GOAL.into()))).await?;
            Ok(String::new())
        })
    });
}

/// Presses the emergency stop in the state that the arm is in, and sees that it is estopped, moves nothing, and comes back by
/// a reset and a new reservation alone.
async fn must_stop_in(cx: &Context, mcs: &TaskRef, state: State) -> Result<(), HandlerError> {
    let status = asked(cx, mcs, Status {}).await?;
    assert_eq!(status.state, state);
    asked(cx, mcs, EmergencyStop {}).await?;
    cx.sleep(Duration::from_millis(20)).await;
    let status = asked(cx, mcs, Status {}).await?;
    assert_eq!((status.state, status.holder), (State::Estopped, None));
    let stands = asked(cx, mcs, ReadPosition {}).await?.joints;
    for refused in [
        error_of(cx, mcs, Acquire {}).await?,
        error_of(cx, mcs, to(Target::Joints(GOAL.into()))).await?,
    ] {
        assert_eq!(refused.outcome, Outcome::Estopped, "{state:?}: {refused}");
    }
    cx.sleep(Duration::from_secs(1)).await;
    assert_eq!(asked(cx, mcs, ReadPosition {}).await?.joints, stands);
    assert_eq!(done(cx, mcs, Reset {}).await?, State::Cold);
    let early = error_of(cx, mcs, to(Target::Joints(GOAL.into()))).await?;
    assert_eq!(early.outcome, Outcome::Refused, "{state:?}: {early}");
    Ok(())
}

#[test]
fn an_emergency_stop_in_any_state_of_rest_is_left_by_a_reset_and_a_new_reservation_alone() {
    text_of(|cx, mcs, _| {
        Box::pin(async move {
            must_stop_in(&cx, &mcs, State::Cold).await?;
            done(&cx, &mcs, Acquire {}).await?;
            must_stop_in(&cx, &mcs, State::Active).await?;
            done(&cx, &mcs, Acquire {}).await?;
            done(&cx, &mcs, to(Target::Joints(GOAL.into()))).await?;
            must_stop_in(&cx, &mcs, State::Motion).await?;
            asked(&cx, &mcs, EmergencyStop {}).await?;
            must_stop_in(&cx, &mcs, State::Estopped).await?;
            done(&cx, &mcs, Acquire {}).await?;
            done(&cx, &mcs, to(Target::Joints(START.into()))).await?;
            Ok(String::new())
        })
    });
}

/// What a request came to: a state, or how it was refused.
async fn came_to<T, C: Command<Reply = Result<T, MotionError>>>(
    cx: &Context,
    mcs: &TaskRef,
    request: C,
) -> Result<Result<(), MotionOutcome>, HandlerError> {
    let answer = asked(cx, mcs, request).await?;
    Ok(answer.map(drop).map_err(|error| error.outcome))
}

/// Brings the arm from wherever it is into a state.
async fn bring(cx: &Context, mcs: &TaskRef, state: State) -> Result<(), HandlerError> {
    asked(cx, mcs, EmergencyStop {}).await?;
    if state == State::Estopped {
        return Ok(());
    }
    done(cx, mcs, Reset {}).await?;
    if state != State::Cold {
        done(cx, mcs, Acquire {}).await?;
    }
    if state == State::Motion {
        done(cx, mcs, to(Target::Joints(START.into()))).await?;
    }
    if state == State::Reserved {
        let unplug = cx.task("unplug").await?;
        asked(cx, &unplug, Unplug {}).await?;
        cx.sleep(Duration::from_millis(20)).await;
    }
    Ok(())
}

ctos::command! {
    /// Has the power of the servo go off by itself, as a drive's own switch does.
    struct Unplug => (), 0x0002, "unplug"
}

#[test]
fn each_request_in_each_state_leads_where_the_table_says() {
    let script: Script = |cx, mcs, knobs| {
        Box::pin(async move {
            use MotionOutcome::{Estopped, Refused};
            use State::{Active, Cold, Estopped as Down, Motion, Reserved};
            let go = || to(Target::Joints(START.into()));
            // From a state: what a reservation, a motion, a release and a reset come to, and the state after each.
            let rows = [
                (
                    Cold,
                    (Ok(()), Active),
                    (Err(Refused), Cold),
                    (Ok(()), Cold),
                    (Err(Refused), Cold),
                ),
                (
                    Reserved,
                    (Ok(()), Active),
                    (Err(Refused), Reserved),
                    (Ok(()), Cold),
                    (Err(Refused), Reserved),
                ),
                (
                    Active,
                    (Ok(()), Active),
                    (Ok(()), Motion),
                    (Ok(()), Cold),
                    (Err(Refused), Active),
                ),
                (
                    Motion,
                    (Ok(()), Motion),
                    (Ok(()), Motion),
                    (Ok(()), Cold),
                    (Err(Refused), Motion),
                ),
                (
                    Down,
                    (Err(Estopped), Down),
                    (Err(Estopped), Down),
                    (Ok(()), Down),
                    (Ok(()), Cold),
                ),
            ];
            for (state, reserve, moves, release, reset) in rows {
                for (what, (wanted, after)) in ["reserve", "move", "release", "reset"]
                    .into_iter()
                    .zip([reserve, moves, release, reset])
                {
                    bring(&cx, &mcs, state).await?;
                    let at = format!("{what} in {state}");
                    let before = asked(&cx, &mcs, Status {}).await?;
                    assert_eq!(before.state, state, "{at}");
                    assert_eq!(
                        before.holder.is_some(),
                        !matches!(state, Cold | Down),
                        "{at}"
                    );
                    let found = match what {
                        "reserve" => came_to(&cx, &mcs, Acquire {}).await?,
                        "move" => came_to(&cx, &mcs, go()).await?,
                        "release" => came_to(&cx, &mcs, Release {}).await?,
                        _ => came_to(&cx, &mcs, Reset {}).await?,
                    };
                    assert_eq!(found, wanted, "{at}");
                    let status = asked(&cx, &mcs, Status {}).await?;
                    assert_eq!(status.state, after, "{at}");
                    assert_eq!(
                        status.holder.is_some(),
                        !matches!(after, Cold | Down),
                        "{at}"
                    );
                    // The drives have what the state means.
                    cx.sleep(Duration::from_millis(20)).await;
                    let (power, _) = knobs.last_write.lock().unwrap().unwrap();
                    assert_eq!(power, after.power(), "{at}");
                }
                bring(&cx, &mcs, state).await?;
                must_stop_in(&cx, &mcs, state).await?;
            }
            Ok(String::new())
        })
    };
    let app = format!("{APP}\n[task.unplug]\nhandler = \"test.unplug\"\non = \"cage/main\"\n");
    let outcome = run_in(&app, script, &Arc::default(), &[]);
    assert!(
        matches!(&outcome.end, End::Finished(result) if result.ok),
        "{:?}",
        outcome.end
    );
}

/// For the registry of the tests.
pub(super) fn register_unplug(registry: &mut Registry) {
    registry.function::<Unplug, _, _>("test.unplug", |cx, Unplug {}| async move {
        Link::find(&cx, "servo")?
            .port
            .order(ServoCommand::PowerOff)?;
        Ok(())
    });
}

#[test]
fn a_controlled_stop_comes_to_rest_before_power_goes_off_and_is_told_for_what_it_is() {
    text_of(|cx, mcs, _| {
        Box::pin(async move {
            done(&cx, &mcs, Acquire {}).await?;
            let told = disturbed(&cx, &mcs, ControlledStop {}).await?;
            assert_eq!(told.outcome, Outcome::Estopped);
            assert!(told.reason.contains("controlled stop"), "{told}");
            let status = asked(&cx, &mcs, Status {}).await?;
            assert_eq!(
                (status.state, status.motion),
                (State::Estopped, MotionPhase::Stopped)
            );
            assert_eq!(status.holder, None);
            let again = error_of(&cx, &mcs, Acquire {}).await?;
            assert_eq!(again.outcome, Outcome::Estopped);
            // Of an arm that stands, and of one without power.
            for _ in 0..2 {
                done(&cx, &mcs, Reset {}).await?;
                asked(&cx, &mcs, ControlledStop {}).await?;
                assert_eq!(asked(&cx, &mcs, Status {}).await?.state, State::Estopped);
            }
            done(&cx, &mcs, Reset {}).await?;
            done(&cx, &mcs, Acquire {}).await?;
            done(&cx, &mcs, to(Target::Joints(GOAL.into()))).await?;
            Ok(String::new())
        })
    });
}

#[test]
fn a_cancelled_motion_ends_at_rest_and_the_next_may_begin_at_once() {
    text_of(|cx, mcs, _| {
        Box::pin(async move {
            done(&cx, &mcs, Acquire {}).await?;
            let told = disturbed(&cx, &mcs, Cancel {}).await?;
            assert_eq!(told.outcome, Outcome::Stopped);
            assert!(told.reason.contains("cancelled"), "{told}");
            assert!(asked(&cx, &mcs, ReadPosition {}).await?.at_rest);
            done(&cx, &mcs, to(Target::Joints(GOAL.into()))).await?;
            Ok(String::new())
        })
    });
}

#[test]
fn an_emergency_stop_and_a_release_in_mid_motion_are_told_for_what_they_are() {
    text_of(|cx, mcs, _| {
        Box::pin(async move {
            done(&cx, &mcs, Acquire {}).await?;
            let told = disturbed(&cx, &mcs, EmergencyStop {}).await?;
            assert_eq!(told.outcome, Outcome::Estopped);
            let again = error_of(&cx, &mcs, to(Target::Joints(GOAL.into()))).await?;
            assert_eq!(again.outcome, Outcome::Estopped);
            assert_eq!(
                error_of(&cx, &mcs, Acquire {}).await?.outcome,
                Outcome::Estopped
            );
            // There is nothing to give back, and that is no error.
            assert_eq!(done(&cx, &mcs, Release {}).await?, State::Estopped);
            done(&cx, &mcs, Reset {}).await?;
            done(&cx, &mcs, Acquire {}).await?;
            let told = disturbed(&cx, &mcs, Release {}).await?;
            assert_eq!(told.outcome, Outcome::Stopped);
            assert_eq!(asked(&cx, &mcs, Status {}).await?.state, State::Cold);
            Ok(String::new())
        })
    });
}

#[test]
fn who_holds_the_manipulator_may_acquire_it_again_and_release_what_is_free() {
    text_of(|cx, mcs, _| {
        Box::pin(async move {
            assert_eq!(done(&cx, &mcs, Release {}).await?, State::Cold);
            assert_eq!(done(&cx, &mcs, Acquire {}).await?, State::Active);
            assert_eq!(done(&cx, &mcs, Acquire {}).await?, State::Active);
            done(&cx, &mcs, to(Target::Joints(GOAL.into()))).await?;
            assert_eq!(done(&cx, &mcs, Acquire {}).await?, State::Motion);
            Ok(String::new())
        })
    });
}

/// Runs a script in an app with a chassis `aside` more, while chassis die at these times, ms.
fn run_dying(script: Script, knobs: &Arc<Knobs>, deaths: &[(&str, u64)]) -> AppResult {
    run_app_dying(APP, script, knobs, deaths)
}

pub(super) fn run_app_dying(
    app: &str,
    script: Script,
    knobs: &Arc<Knobs>,
    deaths: &[(&str, u64)],
) -> AppResult {
    let text = app.replace(
        "[chassis.ws]",
        "[chassis.ws]\nrestart = \"on-failure\"\n[chassis.aside]\nrestart = \"on-failure\"",
    );
    let app = ctos::config::load_texts(&[("app.toml", &text)], &[], &[]).unwrap();
    let kills = deaths.iter().map(|(chassis, ms)| {
        Fault::on(
            (*chassis).to_owned(),
            FaultKind::Kill,
            Instant::from_nanos(ms * 1_000_000),
        )
    });
    let setup = Setup {
        faults: Faults::of_script("deaths", kills.collect()),
        ..Setup::default()
    };
    let observer: ctos::boot::Observer = Arc::new(|_| {});
    let run = simulation::run(app, registry(script, knobs), setup, &observer).unwrap();
    match run.outcome.end {
        End::Finished(result) => result,
        other => panic!("{other:?}"),
    }
}

#[test]
fn the_loss_of_a_chassis_that_the_motion_does_not_need_does_not_stop_the_arm() {
    let script: Script = |cx, mcs, _| {
        Box::pin(async move {
            done(&cx, &mcs, Acquire {}).await?;
            // Some 1.5 s of motion each.
            for goal in [GOAL, START, GOAL].map(Joints::from) {
                done(&cx, &mcs, to(Target::Joints(goal))).await?;
            }
            Ok(String::new())
        })
    };
    let result = run_dying(
        script,
        &Arc::default(),
        &[("aside", 300), ("aside", 1400), ("aside", 2600)],
    );
    assert!(result.ok, "{}", result.text);
}

#[test]
fn when_the_chassis_of_its_holder_is_lost_the_arm_rests_and_it_moves_again_for_the_next() {
    for at in [150, 300, 450, 600, 1000] {
        let knobs = Arc::<Knobs>::default();
        let script: Script = |cx, mcs, knobs| {
            Box::pin(async move {
                let lives = knobs.lives.fetch_add(1, Ordering::Relaxed);
                if lives > 0 {
                    // Its predecessor died in the midst of a motion.
                    let status = asked(&cx, &mcs, Status {}).await?;
                    assert_eq!((status.state, status.holder), (State::Cold, None));
                    let (power, _) = knobs.last_write.lock().unwrap().unwrap();
                    assert_eq!(power, Power::Off);
                }
                done(&cx, &mcs, Acquire {}).await?;
                done(&cx, &mcs, to(Target::Joints(GOAL.into()))).await?;
                done(&cx, &mcs, to(Target::Joints(START.into()))).await?;
                Ok(format!("life {lives}"))
            })
        };
        let result = run_dying(script, &knobs, &[("ws", at)]);
        assert!(result.ok, "{at}: {}", result.text);
        assert_eq!(result.text, "life 1", "{at}");
        // It braked along its path, and power went off at rest.
        let speed = *knobs.speed_at_power_off.lock().unwrap();
        assert!(speed.is_some_and(|speed| speed < 5e-3), "{at}: {speed:?}");
    }
}

#[test]
fn when_the_chassis_of_the_client_interface_is_lost_the_motion_ends_and_the_next_one_can_begin() {
    let script: Script = |cx, mcs, knobs| {
        Box::pin(async move {
            done(&cx, &mcs, Acquire {}).await?;
            let gone = cx.call(&mcs, to(Target::Joints(GOAL.into()))).await;
            assert!(gone.is_err_and(|error| error.is_gone()));
            // Braking takes less than half a second.
            cx.sleep(Duration::from_millis(500)).await;
            let (power, _) = knobs.last_write.lock().unwrap().unwrap();
            assert_eq!(power, Power::Released, "it is still held");
            let mcs = cx.task("mcs").await?;
            let stands = asked(&cx, &mcs, ReadPosition {}).await?;
            assert!(stands.at_rest && (stands.joints[0] - GOAL[0]).abs() > 0.01);
            done(&cx, &mcs, to(Target::Joints(GOAL.into()))).await?;
            Ok(String::new())
        })
    };
    let app = APP.replace(
        "handler = \"mcs.client\"\non = \"ws\"",
        "handler = \"mcs.client\"\non = \"aside\"",
    );
    let result = run_app_dying(&app, script, &Arc::default(), &[("aside", 300)]);
    assert!(result.ok, "{}", result.text);
}

#[test]
fn an_arm_that_something_holds_fast_is_a_fault_and_does_not_push_on() {
    let knobs = Arc::<Knobs>::default();
    let script: Script = |cx, mcs, knobs| {
        Box::pin(async move {
            done(&cx, &mcs, Acquire {}).await?;
            knobs.fault.store(4, Ordering::Relaxed);
            let told = error_of(&cx, &mcs, to(Target::Joints(GOAL.into()))).await?;
            assert_eq!(told.outcome, Outcome::Fault, "{told}");
            assert!(told.reason.contains("joint 1"), "{told}");
            let status = asked(&cx, &mcs, Status {}).await?;
            assert_eq!(status.state, State::Estopped);
            let (power, torques) = knobs.last_write.lock().unwrap().unwrap();
            assert_eq!((power, torques), (Power::Off, Joints::zeros(6)));
            Ok(String::new())
        })
    };
    let outcome = run(script, &knobs, &[]);
    assert!(
        matches!(&outcome.end, End::Finished(result) if result.ok),
        "{:?}",
        outcome.end
    );
}
