//! Setpoints and torques that are streamed to an arm by a task that holds it, from a buffer and in words.

use sorma::snapshot::{Layout, Place, Writer};

use super::*;
use crate::servo::MotionPhase;

/// A buffer of this process alone: tests of one app's name run at once.
fn buffer(name: &str) -> String {
    format!("{name}_{}", std::process::id())
}

fn writer(cx: &Context, name: &str, floats: usize) -> Result<Writer, HandlerError> {
    let place = Place::of_app(&cx.app().name)?;
    let layout = Layout::new(8, floats);
    Ok(Writer::create(&place, name, layout, cx.chassis().clock())?)
}

fn following(kind: StreamKind, buffer: Option<String>) -> StreamSetpoints {
    StreamSetpoints {
        kind,
        buffer,
        max_age_s: 0.1,
        speed: 1.0,
        acceleration: None,
        guards: Vec::new(),
    }
}

#[test]
fn a_buffer_is_followed_until_it_falls_silent_and_only_for_the_task_that_holds_the_arm() {
    text_of(|cx, mcs, _| {
        Box::pin(async move {
            let name = buffer("follow");
            let request = following(StreamKind::Joints, Some(name.clone()));
            let cold = refusal(&cx, &mcs, request.clone()).await?;
            assert!(cold.contains("acquire the manipulator first"), "{cold}");
            done(&cx, &mcs, Acquire {}).await?;
            let none = refusal(&cx, &mcs, request.clone()).await?;
            assert!(none.contains(&name), "{none}");
            let mut writer = writer(&cx, &name, 6)?;
            // Another task asks by its words.
            told(&cx, &format!("setpoint CTRL -buffer {name}")).await?;
            for line in ["setpoint EXEC begin", "setpoint EXEC FMSG 6 0 0 0 0 0 0"] {
                let other = told(&cx, line).await?;
                let text = &other.reports[0].text;
                assert!(text.contains("reserved by task `user`"), "{text}");
            }
            writer.write(&START, &[])?;
            let begun = done(&cx, &mcs, request.clone()).await?;
            assert!(begun.follows, "{begun:?}");
            for step in 0..100 {
                let at = START.map(|joint| joint - 0.003 * f64::from(step));
                writer.write(&at, &[])?;
                cx.sleep(Duration::from_millis(20)).await;
            }
            let there = asked(&cx, &mcs, ReadPosition {}).await?;
            for (joint, start) in there.joints.iter().zip(START) {
                assert!((joint - (start - 0.297)).abs() < 5e-3, "{there:?}");
            }
            let status = asked(&cx, &mcs, Status {}).await?;
            assert_eq!(
                (status.state, status.motion),
                (State::Motion, MotionPhase::Moving)
            );
            // A motion has to wait, and a second stream as well.
            let busy = refusal(&cx, &mcs, to(Target::Joints(GOAL.into()))).await?;
            assert!(
                busy.contains("try again") || busy.contains("stream"),
                "{busy}"
            );
            let twice = refusal(&cx, &mcs, request.clone()).await?;
            assert!(twice.contains("follows a stream"), "{twice}");
            cx.sleep(Duration::from_secs(2)).await;
            let report = asked(&cx, &mcs, ReadStream {}).await?;
            let end = report.end.clone().unwrap_or_default();
            assert!(!report.follows && report.values >= 100, "{report:?}");
            assert!(
                end.contains(&format!("buffer `{name}`: the newest value is")),
                "{end}"
            );
            assert!(asked(&cx, &mcs, ReadPosition {}).await?.at_rest);
            // It is still held, and moves as before.
            done(&cx, &mcs, to(Target::Joints(GOAL.into()))).await?;
            let wrong = following(StreamKind::Tool, Some(name.clone()));
            let wrong = Writer::create(
                &Place::of_app(&cx.app().name)?,
                &buffer("seven"),
                Layout::new(8, 7),
                cx.chassis().clock(),
            )
            .map(|seven| {
                (
                    seven,
                    StreamSetpoints {
                        buffer: Some(buffer("seven")),
                        ..wrong
                    },
                )
            });
            let (_seven, wrong) = wrong?;
            let refused = refusal(&cx, &mcs, wrong).await?;
            assert!(
                refused.contains("has 7 floats and not 6 or 16"),
                "{refused}"
            );
            for (request, expected) in [
                (
                    StreamSetpoints {
                        speed: 1.5,
                        ..request.clone()
                    },
                    "`speed` is above 0",
                ),
                (
                    StreamSetpoints {
                        max_age_s: f64::NAN,
                        ..request.clone()
                    },
                    "not NaN",
                ),
                (
                    StreamSetpoints {
                        guards: vec!["none".to_owned()],
                        ..request.clone()
                    },
                    "none",
                ),
            ] {
                let refused = refusal(&cx, &mcs, request).await?;
                assert!(refused.contains(expected), "{refused}");
            }
            done(&cx, &mcs, Release {}).await?;
            Ok(String::new())
        })
    });
}

#[test]
fn an_arm_that_is_given_back_in_the_midst_of_a_stream_comes_to_rest_first() {
    let knobs = Arc::<Knobs>::default();
    let script: Script = |cx, mcs, _| {
        Box::pin(async move {
            let name = buffer("give");
            done(&cx, &mcs, Acquire {}).await?;
            let mut writer = writer(&cx, &name, 6)?;
            writer.write(&START.map(|joint| joint - 0.7), &[])?;
            let request = StreamSetpoints {
                max_age_s: 10.0,
                ..following(StreamKind::Joints, Some(name))
            };
            done(&cx, &mcs, request).await?;
            cx.sleep(Duration::from_millis(80)).await;
            assert_eq!(done(&cx, &mcs, Release {}).await?, State::Cold);
            let end = asked(&cx, &mcs, ReadStream {})
                .await?
                .end
                .unwrap_or_default();
            assert!(end.contains("its power to be switched"), "{end}");
            Ok(String::new())
        })
    };
    let outcome = run(script, &knobs, &[]);
    assert!(
        matches!(&outcome.end, End::Finished(result) if result.ok),
        "{:?}",
        outcome.end
    );
    let speed = *knobs.speed_at_power_off.lock().unwrap();
    assert!(speed.is_some_and(|speed| speed < 5e-3), "{speed:?}");
}

#[test]
fn words_stream_setpoints_one_by_one_and_tell_what_ended_it() {
    text_of(|cx, mcs, _| {
        Box::pin(async move {
            let none = told(&cx, "setpoint EXEC state").await?;
            assert_eq!(none.text, "no stream has been begun");
            let early = told(&cx, "setpoint EXEC FMSG 6 0 0 0 0 0 0").await?;
            assert!(
                early.reports[0].text.contains("acquire it first"),
                "{early:?}"
            );
            told(&cx, "setpoint CTRL -age 1 -speed 1").await?;
            for line in ["setpoint EXEC acquire", "setpoint EXEC begin"] {
                let answer = told(&cx, line).await?;
                assert!(answer.is_ok(), "{line}: {:?}", answer.reports);
            }
            for step in 1..=20 {
                let first = 0.1 + 0.01 * f64::from(step);
                let line = format!("setpoint EXEC FMSG 6 {first} 0.8 -2.6 0.2 0.7 0.1");
                let answer = told(&cx, &line).await?;
                assert!(answer.is_ok(), "{:?}", answer.reports);
                assert_eq!(
                    answer.text,
                    "the arm follows setpoints that EXEC hands over"
                );
                assert_eq!(answer.ints, [i64::from(step)]);
            }
            cx.sleep(Duration::from_millis(500)).await;
            let there = asked(&cx, &mcs, ReadPosition {}).await?;
            assert!((there.joints[0] - 0.3).abs() < 1e-3, "{there:?}");
            let beyond = told(&cx, "setpoint EXEC FMSG 6 0.3 0.8 -2.6 0.2 2.0 0.1").await?;
            let text = &beyond.reports[0].text;
            assert!(
                text.contains("joint 5 would have to be at 2.0000 rad"),
                "{text}"
            );
            let after = told(&cx, "setpoint EXEC FMSG 6 0.3 0.8 -2.6 0.2 0.7 0.1").await?;
            let text = &after.reports[0].text;
            assert!(text.contains("begin a stream anew"), "{text}");
            cx.sleep(Duration::from_secs(1)).await;
            told(&cx, "setpoint EXEC begin").await?;
            told(&cx, "setpoint EXEC end").await?;
            cx.sleep(Duration::from_secs(1)).await;
            let ended = told(&cx, "setpoint EXEC").await?;
            assert_eq!(ended.text, "the arm follows no more: somebody ended it");
            // The weight, and nothing else: the arm stays where it is.
            told(&cx, "torque CTRL -age 1").await?;
            for line in ["torque EXEC begin", "torque EXEC FMSG 6 0 0 0 0 0 0"] {
                let answer = told(&cx, line).await?;
                assert!(answer.is_ok(), "{line}: {:?}", answer.reports);
            }
            cx.sleep(Duration::from_millis(800)).await;
            let floats = asked(&cx, &mcs, ReadPosition {}).await?;
            assert!((floats.joints[1] - 0.8).abs() < 5e-3, "{floats:?}");
            let few = told(&cx, "torque EXEC FMSG 5 0 0 0 0 0").await?;
            let text = &few.reports[0].text;
            assert!(text.contains("a value has 5 numbers and not 6"), "{text}");
            let released = told(&cx, "setpoint EXEC release").await?;
            assert!(released.is_ok(), "{:?}", released.reports);
            assert_eq!(asked(&cx, &mcs, Status {}).await?.state, State::Cold);
            Ok(String::new())
        })
    });
}

#[test]
fn a_stream_ends_with_the_chassis_of_the_task_that_holds_the_arm() {
    let knobs = Arc::<Knobs>::default();
    let script: Script = |cx, mcs, knobs| {
        Box::pin(async move {
            if knobs.lives.fetch_add(1, Ordering::Relaxed) > 0 {
                let status = asked(&cx, &mcs, Status {}).await?;
                assert_eq!((status.state, status.holder), (State::Cold, None));
                return Ok(String::new());
            }
            done(&cx, &mcs, Acquire {}).await?;
            done(
                &cx,
                &mcs,
                StreamSetpoints {
                    max_age_s: 60.0,
                    ..following(StreamKind::Joints, None)
                },
            )
            .await?;
            let numbers = START.map(|joint| joint - 0.9).to_vec();
            done(&cx, &mcs, StreamValue { numbers }).await?;
            cx.sleep(Duration::from_secs(60)).await;
            Err("it lived on".into())
        })
    };
    let app = APP.replace(
        "handler = \"mcs.client\"\non = \"ws\"",
        "handler = \"mcs.client\"\non = \"cage/main\"",
    );
    let result = stops::run_app_dying(&app, script, &knobs, &[("ws", 300)]);
    assert!(result.ok, "{}", result.text);
    let speed = *knobs.speed_at_power_off.lock().unwrap();
    assert!(speed.is_some_and(|speed| speed < 5e-3), "{speed:?}");
}

#[test]
fn a_stream_ends_with_the_chassis_of_the_client_interface_and_the_arm_is_still_held() {
    let knobs = Arc::<Knobs>::default();
    let script: Script = |cx, mcs, knobs| {
        Box::pin(async move {
            done(&cx, &mcs, Acquire {}).await?;
            let request = StreamSetpoints {
                max_age_s: 60.0,
                ..following(StreamKind::Joints, None)
            };
            done(&cx, &mcs, request).await?;
            let numbers = START.map(|joint| joint - 0.9).to_vec();
            done(&cx, &mcs, StreamValue { numbers }).await?;
            cx.sleep(Duration::from_secs(2)).await;
            let (power, _) = knobs.last_write.lock().unwrap().unwrap();
            assert_eq!(power, Power::Released, "it is still held");
            let mcs = cx.task("mcs").await?;
            let stands = asked(&cx, &mcs, ReadPosition {}).await?;
            assert!(
                stands.at_rest && stands.joints[0] > START[0] - 0.85,
                "{stands:?}"
            );
            let report = asked(&cx, &mcs, ReadStream {}).await?;
            assert!(!report.follows, "{report:?}");
            Ok(String::new())
        })
    };
    let app = APP.replace(
        "handler = \"mcs.client\"\non = \"ws\"",
        "handler = \"mcs.client\"\non = \"aside\"",
    );
    let result = stops::run_app_dying(&app, script, &knobs, &[("aside", 300)]);
    assert!(result.ok, "{}", result.text);
}

#[test]
fn the_tool_listens_to_displacements_from_a_buffer_by_one_word() {
    text_of(|cx, mcs, _| {
        Box::pin(async move {
            let name = buffer("listen");
            let nothing = told(&cx, "mvpos EXEC listen").await?;
            assert!(
                nothing.reports[0].text.contains("-listen BUFFER"),
                "{nothing:?}"
            );
            told(&cx, &format!("mvpos CTRL -listen {name} -speed 1")).await?;
            let none = told(&cx, "mvpos EXEC listen").await?;
            assert!(!none.is_ok());
            assert_eq!(asked(&cx, &mcs, Status {}).await?.state, State::Cold);
            let start = asked(&cx, &mcs, ReadPosition {}).await?.base_t_tool;
            let mut writer = writer(&cx, &name, 6)?;
            writer.write(&[0.0; 6], &[])?;
            let begun = told(&cx, "mvpos EXEC listen").await?;
            assert!(begun.is_ok(), "{:?}", begun.reports);
            let follows = told(&cx, "setpoint EXEC state").await?;
            assert_eq!(
                follows.text,
                format!("the arm follows poses of buffer `{name}`")
            );
            for step in 1..=60 {
                let by = 0.0015 * f64::from(step);
                writer.write(&[0.0, by, -by, 0.0, 0.0, 0.0], &[])?;
                cx.sleep(Duration::from_millis(20)).await;
            }
            let there = asked(&cx, &mcs, ReadPosition {}).await?.base_t_tool;
            for (row, way) in [(3, 0.0), (7, 0.09), (11, -0.09)] {
                assert!(
                    (there[row] - start[row] - way).abs() < 4e-3,
                    "{row}: {there:?}"
                );
            }
            // The usual limit of the age is half a second.
            cx.sleep(Duration::from_secs(2)).await;
            let ended = told(&cx, "setpoint EXEC state").await?;
            assert!(
                ended.text.contains("and the limit is 0.500 s"),
                "{}",
                ended.text
            );
            told(&cx, "mvpos EXEC release").await?;
            assert_eq!(asked(&cx, &mcs, Status {}).await?.state, State::Cold);
            Ok(String::new())
        })
    });
}
