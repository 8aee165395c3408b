//! MCS as an app, in virtual time, with an arm that obeys the equations of motion.

mod asking;
mod drawn;
mod guards;
mod laws;
mod missing;
mod paths;
mod random;
mod slots;
mod stops;
mod streams;
#[path = "../../servo/src/driver/test_arm.rs"]
mod test_arm;

use std::sync::atomic::Ordering;

use ctos::boot::{self, End, Launcher, boot};
use ctos::message::{Command, Message};
use ctos::system::AppResult;
use ctos::task::{EventHandler, Handled, Phase, TaskRef};
use futures_util::future::LocalBoxFuture;

use super::*;
use crate::client::*;
use crate::control::{ControlLaw, LawRegistry};
use crate::driver::SlotReading;
use crate::joints::Joints;
use crate::state::State;
use crate::trajectory::Setpoint;
use test_arm::{Knobs, START, TestArm, built_in_arm};

const GOAL: [f64; 6] = [-0.6, 1.4, -2.9, -0.4, 0.2, 1.1];

const APP: &str = r#"
app.until = "user"
time.mode = "virtual"
[chassis.cage]
stop_first = true
processors.servo = {}
processors.main = {}
[chassis.ws]
[task.servo]
handler = "mcs.servo"
on = "cage/servo"
args.driver = "test.arm"
args.tool_xyz = [0.0, 0.0, 0.1]
[task.state]
handler = "mcs.state"
on = "cage/main"
args.servo = "servo"
[task.planner]
handler = "mcs.planner"
on = "cage/main"
args.servo = "servo"
[task.mcs]
handler = "mcs.client"
on = "ws"
args = { servo = "servo", state = "state", planner = "planner" }
[task.user]
handler = "test.user"
on = "ws"
[task.other]
handler = "test.bystander"
on = "ws"
[task.objects]
handler = "sorma.daemon"
on = "ws"
"#;

type Script =
    fn(Context, TaskRef, Arc<Knobs>) -> LocalBoxFuture<'static, Result<String, HandlerError>>;

/// A task that does what a test's script says, and ends the app with its result.
struct User(Script, Arc<Knobs>);

impl EventHandler for User {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let client = cx.task("mcs").await?;
            let script = (self.0)(cx.clone(), client, Arc::clone(&self.1));
            let own = cx.clone();
            cx.spawn(async move {
                let result = script.await;
                own.finish(AppResult {
                    ok: result.is_ok(),
                    text: result.unwrap_or_else(|error| error.to_string()),
                    json: String::new(),
                });
            });
        }
        Ok(())
    }
}

ctos::command! {
    /// Asks the bystander to try to acquire the manipulator.
    struct Try => String, 0x0001, "try"
}

/// A law of one's own: carries a share of the weight and does nothing else.
struct Limp(f64, Arc<crate::model::Model>);

impl ControlLaw for Limp {
    fn reset(&mut self, _: &[SlotReading]) {}

    fn torques(&mut self, _: &Setpoint, readings: &[SlotReading], _: Duration, out: &mut [f64]) {
        let q: Vec<f64> = readings.iter().map(|reading| reading.position).collect();
        let mut data = self.1.data();
        let weight = self.1.gravity_torques(&mut data, &q);
        for (out, weight) in out.iter_mut().zip(weight) {
            *out = self.0 * weight;
        }
    }
}

fn registry(script: Script, knobs: &Arc<Knobs>) -> Registry {
    let mut registry = Registry::new();
    let mut drivers = DriverRegistry::new();
    let for_arm = Arc::clone(knobs);
    let arm = drivers.driver("test.arm", move |_, _| {
        let arm = built_in_arm("puma560");
        Ok(Box::new(TestArm::new(arm, &START, false, &for_arm)))
    });
    arm.slots(|_, _| Some(6)).keys(&["speed"]);
    let for_arm = Arc::clone(knobs);
    let on_cart = drivers.driver("test.arm_on_cart", move |_, _| {
        let (arm, start) = (built_in_arm("testbed9"), [&[0.0; 3][..], &START].concat());
        Ok(Box::new(TestArm::new(arm, &start, false, &for_arm)))
    });
    on_cart.slots(|_, _| Some(9));
    let mut laws = LawRegistry::new();
    laws.law("test.limp", |settings| {
        #[derive(serde::Deserialize)]
        #[serde(deny_unknown_fields)]
        struct Args {
            share: f64,
        }
        let Args { share } = settings.args.parse()?;
        if share > 1.0 {
            return Err("no more than all of the weight can be carried".into());
        }
        let model = Arc::clone(settings.model);
        Ok(Box::new(Limp(share, model)))
    });
    register(&mut registry, drivers, laws, GuardRegistry::new());
    let mut dictionary = sorma::Dictionary::new();
    let shipped = ctos::diagnostic::Source::new("mcs", crate::services::DICTIONARY);
    dictionary.load(&shipped).unwrap();
    sorma::daemon::register(&mut registry, dictionary, |_, sorm| {
        crate::services::register(sorm);
    });
    let knobs = Arc::clone(knobs);
    registry.handler("test.user", &[], move |_| {
        Ok(User(script, Arc::clone(&knobs)))
    });
    stops::register_unplug(&mut registry);
    registry.function::<Try, _, _>("test.bystander", |cx, Try {}| async move {
        let client = cx.task("mcs").await?;
        refusal(&cx, &client, Acquire {}).await
    });
    registry
}

fn run(script: Script, knobs: &Arc<Knobs>, sets: &[&str]) -> boot::Outcome {
    run_in(APP, script, knobs, sets)
}

/// The same in another app.
fn run_in(text: &str, script: Script, knobs: &Arc<Knobs>, sets: &[&str]) -> boot::Outcome {
    let sets: Vec<String> = sets.iter().map(|set| (*set).to_owned()).collect();
    let app = ctos::config::load_texts(&[("app.toml", text)], &sets, &[]).unwrap();
    let registry = registry(script, knobs);
    let findings = registry.check(&app);
    assert!(findings.is_empty(), "{findings}");
    let launcher = Launcher {
        program: "none".into(),
        arguments: Vec::new(),
    };
    let observer: ctos::boot::Observer = Arc::new(|_| {});
    boot(app, registry, &launcher, &observer).unwrap()
}

/// Runs a script and hands back the text it ended with.
fn text_of(script: Script) -> String {
    let outcome = run(script, &Arc::default(), &[]);
    match outcome.end {
        End::Finished(result) => {
            assert!(result.ok, "{}", result.text);
            result.text
        }
        other => panic!("{other:?}"),
    }
}

async fn asked<C: Command>(
    cx: &Context,
    to: &TaskRef,
    request: C,
) -> Result<C::Reply, HandlerError> {
    let call = cx.call(to, request).deadline(Duration::from_secs(60));
    call.await
        .map_err(|error| HandlerError::new(error.reason()))
}

/// What a request came to that may meet an obstacle.
async fn done<T, C: Command<Reply = Result<T, MotionError>>>(
    cx: &Context,
    to: &TaskRef,
    request: C,
) -> Result<T, HandlerError> {
    Ok(asked(cx, to, request).await??)
}

/// What a request must meet.
async fn error_of<T, C: Command<Reply = Result<T, MotionError>>>(
    cx: &Context,
    to: &TaskRef,
    request: C,
) -> Result<MotionError, HandlerError> {
    match asked(cx, to, request).await? {
        Ok(_) => Err("nothing was in the way".into()),
        Err(error) => Ok(error),
    }
}

/// The refusal that a request must meet.
async fn refusal<T, C: Command<Reply = Result<T, MotionError>>>(
    cx: &Context,
    to: &TaskRef,
    request: C,
) -> Result<String, HandlerError> {
    Ok(error_of(cx, to, request).await?.reason)
}

fn to(target: Target) -> Move {
    Move {
        target,
        path: PathKind::Joint,
        speed: 0.5,
        acceleration: None,
        elbow: None,
        guards: Vec::new(),
        blend: 0.0.into(),
    }
}

#[test]
fn a_user_acquires_moves_reads_back_and_releases() {
    let text = text_of(|cx, mcs, _| {
        Box::pin(async move {
            assert_eq!(done(&cx, &mcs, Acquire {}).await?, State::Active);
            let report = done(&cx, &mcs, to(Target::Joints(GOAL.into()))).await?;
            assert!(report.max_tracking_error_rad < 4e-3, "{report:?}");
            assert!(report.final_error_rad < 5e-4, "{report:?}");
            let position = asked(&cx, &mcs, ReadPosition {}).await?;
            for (read, goal) in position.joints.iter().zip(&GOAL) {
                assert!((read - goal).abs() < 5e-4);
            }
            // Back, and on to a pose along a straight line.
            done(&cx, &mcs, to(Target::Joints(START.into()))).await?;
            let mut pose = asked(&cx, &mcs, ReadPosition {}).await?.base_t_tool;
            pose[7] += 0.2;
            let line = Move {
                path: PathKind::StraightLine,
                ..to(Target::Pose(pose))
            };
            done(&cx, &mcs, line).await?;
            let aside = asked(&cx, &mcs, ReadPosition {}).await?;
            assert!((aside.base_t_tool[7] - pose[7]).abs() < 1e-3);
            let status = asked(&cx, &mcs, Status {}).await?;
            assert_eq!(status.holder.as_deref(), Some("user"));
            assert_eq!(status.state, State::Motion);
            assert_eq!(done(&cx, &mcs, Release {}).await?, State::Cold);
            Ok(format!("{report:?} {position:?}"))
        })
    });
    assert!(text.contains("duration_s"));
}

/// Several moves at once, each in its turn; what they came to.
async fn all_of(
    cx: &Context,
    mcs: &TaskRef,
    goals: &[[f64; 6]],
    blend: f64,
) -> Result<Vec<Result<MoveReport, MotionError>>, HandlerError> {
    let moves = goals.iter().map(|goal| {
        let order = Move {
            blend: blend.into(),
            ..to(Target::Joints((*goal).into()))
        };
        asked(cx, mcs, order)
    });
    let answers = futures_util::future::join_all(moves).await;
    answers.into_iter().collect()
}

#[test]
fn moves_that_come_while_one_is_under_way_wait_and_blended_they_take_less_time() {
    let text = text_of(|cx, mcs, _| {
        Box::pin(async move {
            done(&cx, &mcs, Acquire {}).await?;
            let mut took = Vec::new();
            for blend in [0.0, 0.5] {
                let begun = cx.now();
                let answers = all_of(&cx, &mcs, &[GOAL, [0.0; 6], START], blend).await?;
                took.push((cx.now() - begun).as_secs_f64());
                for answer in answers {
                    assert!(answer?.max_tracking_error_rad < 8e-3);
                }
                let stands = asked(&cx, &mcs, ReadPosition {}).await?;
                assert!(stands.at_rest && (stands.joints[0] - START[0]).abs() < 1e-3);
            }
            assert!(took[1] + 0.5 < took[0], "{took:?}");
            let wrong = Move {
                blend: 1.5.into(),
                ..to(Target::Joints(GOAL.into()))
            };
            refusal(&cx, &mcs, wrong).await
        })
    });
    assert_eq!(text, "a blend is 0 to 1, not 1.5");
}

#[test]
fn each_mover_in_the_queue_is_told_what_ended_it_and_the_ninth_that_there_is_no_room() {
    let text = text_of(|cx, mcs, _| {
        Box::pin(async move {
            done(&cx, &mcs, Acquire {}).await?;
            let stop = async {
                cx.sleep(Duration::from_millis(300)).await;
                asked(&cx, &mcs, Cancel {}).await
            };
            let goals: Vec<[f64; 6]> = [GOAL, START].repeat(4).into_iter().chain([GOAL]).collect();
            let moving = all_of(&cx, &mcs, &goals, 0.5);
            let (stopped, answers) = futures_util::future::join(stop, moving).await;
            stopped?;
            let told = answers?.into_iter().map(|answer| match answer {
                Ok(report) => format!("{report:?}"),
                Err(error) => error.to_string(),
            });
            let told: Vec<String> = told.collect();
            // The next one begins where the arm has come to rest.
            done(&cx, &mcs, to(Target::Joints(GOAL.into()))).await?;
            Ok(told.join("\n"))
        })
    });
    let lines: Vec<&str> = text.lines().collect();
    let rests = "; the arm has come to rest on the way";
    assert_eq!(lines[0], format!("cancelled before its end{rests}"));
    for line in &lines[1..8] {
        assert_eq!(*line, format!("cancelled before it began{rests}"));
    }
    assert!(
        lines[8].starts_with("8 motions are under way or wait"),
        "{text}"
    );
}

#[test]
fn the_same_seed_gives_the_same_bits() {
    let once = || {
        text_of(|cx, mcs, _| {
            Box::pin(async move {
                done(&cx, &mcs, Acquire {}).await?;
                let report = done(&cx, &mcs, to(Target::Joints(GOAL.into()))).await?;
                Ok(format!("{report:?}"))
            })
        })
    };
    assert_eq!(once(), once());
}

#[test]
fn bad_targets_are_refused_before_anything_moves_and_say_why() {
    let text = text_of(|cx, mcs, _| {
        Box::pin(async move {
            done(&cx, &mcs, Acquire {}).await?;
            let mut beyond = Joints::from(START);
            beyond[4] = 2.0;
            let mut nan = Joints::from(START);
            nan[0] = f64::NAN;
            let far = [
                1., 0., 0., 3., 0., 1., 0., 0., 0., 0., 1., 0.5, 0., 0., 0., 1.,
            ];
            let mut no_rotation = far;
            no_rotation[0] = 2.0;
            let mut lines = Vec::new();
            for target in [
                Target::Joints(beyond),
                Target::Joints(nan),
                Target::Pose(far),
                Target::Pose(no_rotation),
            ] {
                lines.push(refusal(&cx, &mcs, to(target)).await?);
            }
            let fast = Move {
                speed: 1.5,
                ..to(Target::Joints(GOAL.into()))
            };
            lines.push(refusal(&cx, &mcs, fast).await?);
            let plan = Plan {
                target: Target::Joints(beyond),
                path: PathKind::Joint,
                speed: 0.5,
                acceleration: None,
                elbow: None,
            };
            lines.push(refusal(&cx, &mcs, plan).await?);
            let position = asked(&cx, &mcs, ReadPosition {}).await?;
            for (read, start) in position.joints.iter().zip(&START) {
                assert!((read - start).abs() < 1e-3);
            }
            Ok(lines.join("\n"))
        })
    });
    let lines: Vec<&str> = text.lines().collect();
    assert!(
        lines[0].contains("joint 5 would have to be at 2.0000 rad, its limits are"),
        "{text}"
    );
    assert!(
        lines[1].contains("the target of joint 1 is not a finite number"),
        "{text}"
    );
    assert!(lines[2].contains("out of reach"), "{text}");
    assert!(lines[3].contains("no rotation"), "{text}");
    assert!(lines[4].contains("speed 1.5 is not a fraction"), "{text}");
    assert!(lines[5].contains("joint 5"), "{text}");
}

#[test]
fn only_the_holder_moves_and_only_after_acquiring() {
    let text = text_of(|cx, mcs, _| {
        Box::pin(async move {
            let cold = refusal(&cx, &mcs, to(Target::Joints(GOAL.into()))).await?;
            done(&cx, &mcs, Acquire {}).await?;
            let other = cx.task("other").await?;
            let held = asked(&cx, &other, Try {}).await?;
            Ok(format!("{cold}\n{held}"))
        })
    });
    assert!(text.contains("acquire the manipulator first"), "{text}");
    assert!(
        text.contains(
            "`reserve` by task `other` refused: the manipulator is reserved by task `user`"
        ),
        "{text}"
    );
}

#[test]
fn after_an_emergency_stop_reset_and_a_new_reservation_are_needed() {
    let text = text_of(|cx, mcs, _| {
        Box::pin(async move {
            done(&cx, &mcs, Acquire {}).await?;
            done(&cx, &mcs, to(Target::Joints(GOAL.into()))).await?;
            asked(&cx, &mcs, EmergencyStop {}).await?;
            cx.sleep(Duration::from_millis(20)).await;
            let status = asked(&cx, &mcs, Status {}).await?;
            assert_eq!(status.state, State::Estopped);
            let first = refusal(&cx, &mcs, Acquire {}).await?;
            assert_eq!(done(&cx, &mcs, Reset {}).await?, State::Cold);
            let second = refusal(&cx, &mcs, to(Target::Joints(START.into()))).await?;
            done(&cx, &mcs, Acquire {}).await?;
            done(&cx, &mcs, to(Target::Joints(START.into()))).await?;
            Ok(format!("{first}\n{second}"))
        })
    });
    assert!(text.contains("reset it, then acquire it anew"), "{text}");
    assert!(text.contains("acquire the manipulator first"), "{text}");
}

#[test]
fn a_driver_fault_in_mid_motion_is_told_to_the_mover_in_the_drivers_words() {
    let text = text_of(|cx, mcs, knobs| {
        Box::pin(async move {
            done(&cx, &mcs, Acquire {}).await?;
            let own = cx.clone();
            cx.spawn(async move {
                own.sleep(Duration::from_millis(300)).await;
                knobs.fault.store(2, Ordering::Relaxed);
            });
            let told = refusal(&cx, &mcs, to(Target::Joints(GOAL.into()))).await?;
            let status = asked(&cx, &mcs, Status {}).await?;
            assert_eq!(status.state, State::Estopped);
            assert!(
                status
                    .fault
                    .is_some_and(|fault| fault.contains("cable out"))
            );
            Ok(told)
        })
    });
    assert!(text.contains("cable out"), "{text}");
}

#[test]
fn when_the_app_ends_in_mid_motion_the_arm_is_at_rest_without_power() {
    let knobs = Arc::<Knobs>::default();
    let script: Script = |cx, mcs, knobs| {
        Box::pin(async move {
            done(&cx, &mcs, Acquire {}).await?;
            let own = cx.clone();
            cx.spawn(async move {
                let told = refusal(&own, &mcs, to(Target::Joints(GOAL.into())))
                    .await
                    .ok();
                *knobs.told.lock().unwrap() = told;
            });
            cx.sleep(Duration::from_millis(300)).await;
            Ok(String::new())
        })
    };
    let outcome = run(script, &knobs, &[]);
    assert!(matches!(outcome.end, End::Finished(_)));
    assert_eq!(
        *knobs.last_write.lock().unwrap(),
        Some((Power::Off, Joints::zeros(6)))
    );
    let told = knobs.told.lock().unwrap().clone();
    assert_eq!(
        told.as_deref(),
        Some("stopped because the app has finished")
    );
    // Braked along the path: never dropped while it moved.
    assert!(
        knobs
            .speed_at_power_off
            .lock()
            .unwrap()
            .is_some_and(|speed| speed < 5e-3)
    );
}

fn findings_of(sets: &[&str]) -> String {
    findings_in(APP, sets)
}

/// The same of another app.
fn findings_in(text: &str, sets: &[&str]) -> String {
    let sets: Vec<String> = sets.iter().map(|set| (*set).to_owned()).collect();
    let app = ctos::config::load_texts(&[("app.toml", text)], &sets, &[]).unwrap();
    let script: Script = |_, _, _| Box::pin(async { Ok(String::new()) });
    registry(script, &Arc::default()).check(&app).to_string()
}

#[test]
fn wrong_arguments_are_found_before_anything_starts() {
    let cases = [
        (
            "task.servo.args.driver=test.amr",
            "did you mean `test.arm`?",
        ),
        (
            "task.servo.args.driver_args.speeed=3",
            "gives `args.driver_args.speeed`, and its channel driver `test.arm` does not read it",
        ),
        (
            "task.servo.args.driver_args.speeed=3",
            "did you mean `speed`?",
        ),
        ("task.servo.args.period_ms=0", "`period_ms` is 0"),
        ("task.servo.args.bandwidth_hz=40", "`bandwidth_hz` is 40"),
        (
            "task.servo.args.velocity=[9.0,1,1,1,1,1]",
            "`velocity` is 9",
        ),
        (
            "task.servo.args.velocity=[1,1,1]",
            "give one for each of the 6 joints of `puma560`",
        ),
        ("task.servo.args.perod_ms=4.5", "did you mean `period_ms`?"),
        (
            "task.servo.args.model=puma56",
            "there is no model `puma56` (did you mean `puma560`?)",
        ),
        (
            "task.servo.args.model=arms/none.urdf",
            "arms/none.urdf`: No such file",
        ),
        (
            "task.servo.args.model=testbed9",
            "the channel driver `test.arm` has 6 slots, and the arm `testbed9` has 9 joints",
        ),
        ("task.servo.args.tip=hand", "`puma560` has no frame `hand`"),
        ("task.servo.args.base=floor", "`base` is of a URDF"),
        ("task.servo.args.law=pdi", "did you mean `pid`?"),
        ("task.servo.args.law_args.stiff=1", "control law `pid`: "),
        ("task.state.args.servo=servos", "did you mean `servo`?"),
        ("task.planner.on=ws", "must be on one chassis"),
        (
            "task.mcs.args.planner=state",
            "no task with the handler `mcs.planner` is called `state`",
        ),
    ];
    for (set, expected) in cases {
        let found = findings_of(&[set]);
        assert!(found.contains(expected), "{set}: {found}");
        assert!(found.contains(':'), "{found}");
    }
}

#[test]
fn a_urdf_is_an_arm_once_it_is_said_how_hard_its_joints_may_accelerate() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/known_answers");
    let model = format!("task.servo.args.model={folder}/six_axes.urdf");
    let arm = [
        &model[..],
        "task.servo.args.base=foot",
        "task.servo.args.tip=wrist_3",
    ];
    let found = findings_of(&arm);
    // One joint of it is continuous and has no limits at all.
    let lacks = |what: &str| found.contains(&format!("has no largest {what}"));
    assert!(lacks("acceleration") && lacks("velocity"), "{found}");
    assert!(
        found.contains("joint `turn_1` has no largest velocity"),
        "{found}"
    );
    let limits = [
        "task.servo.args.velocity=[1,1,1,1,1,1]",
        "task.servo.args.acceleration=[9,9,9,9,9,9]",
    ];
    assert_eq!(findings_of(&[&arm[..], &limits].concat()), "");
}

/// The arm on a cart in place of the arm.
const ON_CART: [&str; 2] = [
    "task.servo.args.driver=test.arm_on_cart",
    "task.servo.args.model=testbed9",
];

#[test]
fn nine_joints_move_as_six_do_by_joints_by_line_and_by_text() {
    let script: Script = |cx, mcs, _| {
        Box::pin(async move {
            let goal = Joints::try_from(&[&[0.4, -0.3, 0.1][..], &GOAL].concat()[..])?;
            done(&cx, &mcs, Acquire {}).await?;
            let report = done(&cx, &mcs, to(Target::Joints(goal))).await?;
            assert!(report.max_tracking_error_rad < 4e-3, "{report:?}");
            assert!(report.max_tracking_error_m < 1e-3, "{report:?}");
            let mut pose = asked(&cx, &mcs, ReadPosition {}).await?.base_t_tool;
            pose[3] += 0.5;
            let line = Move {
                path: PathKind::StraightLine,
                ..to(Target::Pose(pose))
            };
            done(&cx, &mcs, line).await?;
            let there = asked(&cx, &mcs, ReadPosition {}).await?;
            for (found, wanted) in there.base_t_tool.iter().zip(&pose) {
                assert!((found - wanted).abs() < 1e-3, "{there:?}");
            }
            let six = refusal(&cx, &mcs, to(Target::Joints(GOAL.into()))).await?;
            assert_eq!(six, "the arm has 9 joints, and the target has 6 positions");
            let elbow = Move {
                elbow: Some(crate::model::inverse::Elbow::Above),
                ..to(Target::Pose(pose))
            };
            let elbow = error_of(&cx, &mcs, elbow).await?;
            assert_eq!(elbow.outcome, Outcome::Unreachable, "{elbow}");
            done(&cx, &mcs, Release {}).await?;
            let moved = told(&cx, "mvpos EXEC by FMSG 9 -0.2 0 0 0 0 0 0 0 0.1").await?;
            assert!(moved.is_ok(), "{:?}", moved.reports);
            assert_eq!(moved.floats.len(), 10);
            assert_eq!(told(&cx, "pino EXEC state").await?.floats.len(), 9 + 16);
            let there = "0.1 0 0 0 0 0 0 0 0.1";
            told(&cx, "mvpos CTRL -blend 0.5").await?;
            let line = "mvpos EXEC along FMSG 18 0.2 0 0 0 0.8 -2.6 0.2 0.7 0.1 -0.2 0 0 0.3 0.5 -2.2 0 0.4 0.1";
            let along = told(&cx, line).await?;
            assert!(along.is_ok(), "{:?}", along.reports);
            assert!(
                (along.floats[0] + 0.2).abs() < 1e-3 && along.floats.len() == 10,
                "{along:?}"
            );
            let wrong = told(&cx, &format!("mvpos EXEC along FMSG 10 0 {there}")).await?;
            let text = &wrong.reports[0].text;
            assert_eq!(
                text,
                "EXEC along takes 9 floats for each of 1 to 8 positions, not 10 in all"
            );
            // A flavor's position has as many numbers as the arm has joints.
            told(
                &cx,
                "mvpos.home CTRL -to 0 0 0 0.1 0.8 -2.6 0.2 0.7 0.1 -speed 0.5",
            )
            .await?;
            let home = told(&cx, "mvpos.home EXEC").await?;
            assert!(home.is_ok(), "{:?}", home.reports);
            assert!((home.floats[4] - 0.8).abs() < 1e-3, "{home:?}");
            let wrong = told(&cx, "mvpos EXEC joints FMSG 6 0 0 0 0 0 0").await?;
            let text = &wrong.reports[0].text;
            assert!(
                text.contains("takes 9 floats") && text.contains("not 6"),
                "{text}"
            );
            told(
                &cx,
                "dict CTRL -add position.rest '0 0 0 0.1 0.8 -2.6 0.2 0.7 0.1'",
            )
            .await?;
            let rest = told(&cx, "mvpos EXEC rest").await?;
            assert!(rest.is_ok(), "{:?}", rest.reports);
            Ok(String::new())
        })
    };
    let outcome = run(script, &Arc::default(), &ON_CART);
    assert!(
        matches!(&outcome.end, End::Finished(result) if result.ok),
        "{:?}",
        outcome.end
    );
}

#[test]
fn a_law_of_ones_own_is_found_by_its_name_with_its_arguments() {
    let limp = |share: &str| {
        let share = format!("task.servo.args.law_args.share={share}");
        findings_of(&["task.servo.args.law=test.limp", &share])
    };
    assert_eq!(limp("0.9"), "");
    let found = limp("1.5");
    assert!(
        found.contains("control law `test.limp`: no more than all of the weight can be carried"),
        "{found}"
    );
    let script: Script = |cx, mcs, _| {
        Box::pin(async move {
            assert_eq!(asked(&cx, &mcs, ReadControl {}).await?.law, "test.limp");
            done(&cx, &mcs, Acquire {}).await?;
            // It does not move at all.
            let told = error_of(&cx, &mcs, to(Target::Joints(GOAL.into()))).await?;
            assert_eq!(told.outcome, Outcome::Fault, "{told}");
            Ok(String::new())
        })
    };
    let own = [
        "task.servo.args.law=test.limp",
        "task.servo.args.law_args.share=1",
    ];
    let outcome = run(script, &Arc::default(), &own);
    assert!(
        matches!(&outcome.end, End::Finished(result) if result.ok),
        "{:?}",
        outcome.end
    );
}

/// What an object of the app answers to a line of text.
async fn told(cx: &Context, line: &str) -> Result<sorma::Transport, HandlerError> {
    let objects = cx.task("objects").await?;
    let say = sorma::daemon::Say {
        line: line.to_owned(),
        from: "a person".to_owned(),
        trace: 0,
    };
    let reply = asked(cx, &objects, say).await?;
    let reply = reply.parse::<sorma::Reply>();
    Ok(reply
        .map_err(|error| HandlerError::new(error.to_string()))?
        .body)
}

#[test]
fn one_line_of_text_moves_the_arm_of_the_app_and_gives_it_back() {
    text_of(|cx, mcs, _| {
        Box::pin(async move {
            let moved = told(&cx, "mvpos EXEC joints FMSG 6 -0.6 1.4 -2.9 -0.4 0.2 1.1").await?;
            assert!(moved.is_ok(), "{:?}", moved.reports);
            for (found, goal) in moved.floats.iter().zip(GOAL) {
                assert!((found - goal).abs() < 1e-3, "{moved:?}");
            }
            assert_eq!(asked(&cx, &mcs, Status {}).await?.state, State::Cold);
            let seen = told(&cx, "pino EXEC state").await?;
            assert!(
                seen.text.starts_with("cold, held by nobody, motion"),
                "{}",
                seen.text
            );
            assert!((seen.floats[0] - GOAL[0]).abs() < 1e-3);
            assert!(seen.ints[0] > 0);
            // Kept, it can be moved again at once, and nobody else can.
            told(&cx, "mvpos CTRL -keep").await?;
            let on = told(&cx, "mvpos EXEC by FMSG 6 0.1 0 0 0 0 0").await?;
            assert!(on.is_ok(), "{:?}", on.reports);
            let refused = refusal(&cx, &mcs, Acquire {}).await?;
            assert!(refused.contains("reserved by task `objects`"), "{refused}");
            let released = told(&cx, "mvpos EXEC release").await?;
            assert!(released.is_ok(), "{:?}", released.reports);
            assert_eq!(asked(&cx, &mcs, Status {}).await?.state, State::Cold);
            // What the app refuses is said in its words.
            let refused = told(&cx, "mvpos EXEC joints FMSG 6 0 0 0 0 2 0").await?;
            assert_eq!(refused.code, crate::services::code::MOTION);
            assert!(refused.reports[0].text.contains("joint 5"), "{refused:?}");
            assert_eq!(asked(&cx, &mcs, Status {}).await?.state, State::Cold);
            Ok(String::new())
        })
    });
}

#[test]
fn a_person_stops_the_arm_while_another_request_moves_it() {
    text_of(|cx, _, _| {
        Box::pin(async move {
            let slow = "mvpos CTRL -speed 0.05";
            told(&cx, slow).await?;
            let own = cx.clone();
            let moving = async move { told(&own, "mvpos EXEC ready").await };
            let stopping = async {
                cx.sleep(Duration::from_secs(1)).await;
                told(&cx, "pino EXEC stop").await
            };
            let (moved, stopped) = futures_util::future::join(moving, stopping).await;
            assert!(stopped?.is_ok());
            let text = moved?.reports[0].text.clone();
            assert!(text.contains("protective stop"), "{text}");
            Ok(String::new())
        })
    });
}

#[test]
fn control_parameters_are_read_and_set_and_a_softer_loop_follows_worse() {
    text_of(|cx, mcs, _| {
        Box::pin(async move {
            let control = told(&cx, "pino EXEC control").await?;
            assert_eq!(
                (control.text.as_str(), &control.floats[..2]),
                ("pid", &[8.0, 1.0][..])
            );
            done(&cx, &mcs, Acquire {}).await?;
            let stiff = done(&cx, &mcs, to(Target::Joints(GOAL.into()))).await?;
            let set = told(&cx, "pino EXEC set FMSG 2 4 1").await?;
            assert_eq!(set.floats[0], 4.0, "{:?}", set.reports);
            let soft = done(&cx, &mcs, to(Target::Joints(Joints::zeros(6)))).await?;
            assert!(soft.max_tracking_error_rad > 2.0 * stiff.max_tracking_error_rad);
            let refused = told(&cx, "pino EXEC set FMSG 2 400 1").await?;
            assert_eq!(refused.code, sorma::report::code::REFUSED);
            assert_eq!(told(&cx, "pino EXEC control").await?.floats[0], 4.0);
            done(&cx, &mcs, Release {}).await?;
            Ok(String::new())
        })
    });
}
