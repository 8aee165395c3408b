//! The stand-ins of the rig: they do what they are asked, or fail as the script says.

use std::time::Duration;

use ctos::{
    message::{Command, CommandInfo, Message},
    task::{Context, EventHandler, Handled},
};
use mcs::{
    Joints,
    client::{
        Acquire, Cancel, MotionError, Move, MoveReport, Outcome as Motion, Plan, PlanReport,
        Position, ReadPosition, Release, Status, StatusReport, Target,
    },
    servo::MotionPhase,
    state::State,
};
use nalgebra::Matrix4;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use vss::{
    calibrate::{Calibration, calibrate},
    camera::Camera,
    command::{
        Calibrate, NamedCamera, Outcome as Vision, SpotFind, SpotReport, TrueCameras, VisionError,
    },
};

use super::{Answer, Script, SetLamp, Shared, World, cameras, lock, spot};
use crate::{
    dom::{Dom, GetData, PutAll, PutData, SetValidity},
    outcome::Outcome,
};

#[derive(Clone)]
pub(super) struct StandIn {
    pub(super) world: Shared,
    pub(super) script: Script,
}

impl StandIn {
    fn answer(&self, command: &str, detail: &str) -> Answer {
        let occurrence = {
            let mut world = lock(&self.world);
            let key = (command.to_owned(), detail.to_owned());
            let asked = world.asked.entry(key).or_default();
            *asked += 1;
            *asked - 1
        };
        (self.script)(command, detail, occurrence)
    }

    /// Answers by the script; work takes `seconds`. `meet` makes an answer of what is in the way.
    fn play<C: Command>(
        &self,
        cx: &Context,
        message: Message,
        seconds: f64,
        detail: impl FnOnce(&C) -> String,
        (meet, usual): (Meet<C>, Outcome),
        work: impl FnOnce(&mut World, C) -> Result<C::Reply, String> + 'static,
    ) -> Handled {
        let (request, reply) = message.open::<C>()?;
        let detail = detail(&request);
        match self.answer(C::NAME, &detail) {
            answer @ (Answer::Work | Answer::Lost | Answer::Taken) => {
                let (child, world) = (cx.clone(), self.world.clone());
                cx.spawn(async move {
                    let begin = child.now().since_start().as_secs_f64();
                    child.sleep(Duration::from_secs_f64(seconds)).await;
                    let end = child.now().since_start().as_secs_f64();
                    let mut locked = lock(&world);
                    let entry = (C::NAME.to_owned(), detail, begin, end);
                    locked.log.push(entry);
                    let worked = work(&mut locked, request);
                    locked.reserved &= answer != Answer::Taken;
                    drop(locked);
                    if answer == Answer::Lost {
                        return;
                    }
                    let _ = match worked {
                        Ok(done) => reply.ok(done),
                        Err(reason) => reply.fail(reason),
                    };
                });
                Ok(())
            }
            Answer::Refuse => {
                let reason = format!("{} {detail}: refused on purpose", C::NAME);
                match meet(usual, reason) {
                    Ok(met) => reply.ok(met),
                    Err(reason) => reply.fail(reason),
                }
            }
            Answer::Meet(outcome) => {
                let reason = format!("{} {detail}: {outcome} on purpose", C::NAME);
                if outcome == Outcome::Stopped {
                    lock(&self.world).stopped = true;
                }
                match meet(outcome, reason) {
                    Ok(met) => reply.ok(met),
                    Err(reason) => reply.fail(reason),
                }
            }
            Answer::Silent => Ok(()),
            Answer::Late => {
                let child = cx.clone();
                cx.spawn(async move {
                    child.sleep(Duration::from_secs(600)).await;
                    let _ = reply.fail("too late anyway");
                });
                Ok(())
            }
            Answer::Crash => panic!("{} {detail}: crashed on purpose", C::NAME),
        }
    }
}

fn none<C>(_: &C) -> String {
    String::new()
}

/// Makes an answer of an outcome and a reason: a typed one, or a refusal.
type Meet<C> = fn(Outcome, String) -> Result<<C as Command>::Reply, String>;

/// For commands whose answers have no outcomes.
fn refuse<T>(_: Outcome, reason: String) -> Result<T, String> {
    Err(reason)
}

fn motion<T>(outcome: Outcome, reason: String) -> Result<Result<T, MotionError>, String> {
    let outcome = match outcome {
        Outcome::Unreachable => Motion::Unreachable,
        Outcome::Stopped => Motion::Stopped,
        Outcome::Estopped => Motion::Estopped,
        Outcome::Guard => Motion::Guard,
        Outcome::Fault => Motion::Fault,
        Outcome::Lost => Motion::Lost,
        _ => Motion::Refused,
    };
    Ok(Err(MotionError { outcome, reason }))
}

fn vision<T>(outcome: Outcome, reason: String) -> Result<Result<T, VisionError>, String> {
    let outcome = match outcome {
        Outcome::Unseen => Vision::Unseen,
        Outcome::Fault => Vision::Fault,
        Outcome::Lost => Vision::Lost,
        _ => Vision::Refused,
    };
    Ok(Err(VisionError { outcome, reason }))
}

pub(super) struct Mcs(pub(super) StandIn);

impl EventHandler for Mcs {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        let typed = Outcome::Refused;
        match message.command() {
            Acquire::CODE => {
                let meet = (motion::<State> as Meet<Acquire>, typed);
                self.0
                    .play::<Acquire>(cx, message, 0.1, none, meet, |world, _| {
                        world.reserved = true;
                        Ok(Ok(State::Active))
                    })
            }
            Plan::CODE => self.0.play::<Plan>(
                cx,
                message,
                0.01,
                |plan| match (&plan.target, plan.elbow) {
                    (Target::Joints(_), _) => "joints".to_owned(),
                    (_, elbow) => format!("{elbow:?}"),
                },
                (motion::<PlanReport>, Outcome::Unreachable),
                |world, plan| {
                    let joints = match plan.target {
                        Target::Joints(joints) => joints,
                        Target::Pose(pose) => {
                            world.planned.push(pose);
                            [world.planned.len() as f64, 0.0, 0.0, 0.0, 0.0, 0.0].into()
                        }
                    };
                    Ok(Ok(PlanReport {
                        joints,
                        duration_s: 1.0,
                        smallest_singular_value: None,
                    }))
                },
            ),
            Move::CODE => {
                let meet = (motion::<MoveReport> as Meet<Move>, typed);
                self.0
                    .play::<Move>(cx, message, 1.2, none, meet, |world, request| {
                        if !world.reserved {
                            return motion(Outcome::Refused, "not reserved".to_owned());
                        }
                        if world.stopped {
                            return motion(Outcome::Stopped, "a stop holds".to_owned());
                        }
                        world.pose = match request.target {
                            Target::Pose(pose) => pose,
                            Target::Joints(joints) => world.planned[joints[0] as usize - 1],
                        };
                        Ok(Ok(MoveReport {
                            duration_s: 1.2,
                            max_tracking_error_rad: 0.01,
                            max_tracking_error_m: 0.0,
                            final_error_rad: 0.001,
                            final_error_m: 0.0,
                            joints: Joints::zeros(6),
                            smallest_singular_value: None,
                        }))
                    })
            }
            ReadPosition::CODE => {
                let meet = (refuse::<Position> as Meet<ReadPosition>, typed);
                self.0
                    .play::<ReadPosition>(cx, message, 0.2, none, meet, |world, _| {
                        Ok(Position {
                            joints: Joints::zeros(6),
                            base_t_tool: world.pose,
                            commanded: Joints::zeros(6),
                            base_t_commanded: world.pose,
                            at_rest: true,
                        })
                    })
            }
            Status::CODE => {
                let meet = (refuse::<StatusReport> as Meet<Status>, typed);
                let now = cx.now().since_start().as_secs_f64();
                self.0
                    .play::<Status>(cx, message, 0.01, none, meet, move |world, _| {
                        if world.resume_at_s.is_some_and(|at| now >= at) {
                            world.stopped = false;
                        }
                        Ok(StatusReport {
                            state: match world.reserved {
                                true => State::Active,
                                false => State::Cold,
                            },
                            holder: world.reserved.then(|| "motion".to_owned()),
                            fault: None,
                            stopped: world.stopped,
                            motion: MotionPhase::None,
                            ticks: 0,
                            missed: 0,
                        })
                    })
            }
            Cancel::CODE => {
                let meet = (refuse::<()> as Meet<Cancel>, typed);
                self.0
                    .play::<Cancel>(cx, message, 0.1, none, meet, |_, _| Ok(()))
            }
            Release::CODE => {
                let meet = (motion::<State> as Meet<Release>, typed);
                self.0
                    .play::<Release>(cx, message, 0.1, none, meet, |world, _| {
                        world.reserved = false;
                        Ok(Ok(State::Cold))
                    })
            }
            _ => cx.default_processing(message),
        }
    }
}

pub(super) struct Vsm(pub(super) StandIn);

impl EventHandler for Vsm {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            SpotFind::CODE => {
                let detail = |request: &SpotFind| request.camera.clone();
                let meet = (vision::<SpotReport> as Meet<SpotFind>, Outcome::Unseen);
                self.0.play(
                    cx,
                    message,
                    0.4,
                    detail,
                    meet,
                    |world, request: SpotFind| {
                        if !world.lamp_on {
                            let reason = format!("camera `{}`: too dark", request.camera);
                            return vision(Outcome::Unseen, reason);
                        }
                        let lamp = Matrix4::from_row_slice(&world.pose).column(3).xyz();
                        let mut known = cameras().into_iter();
                        let camera = known.find(|(name, _)| *name == request.camera);
                        let (_, camera) = camera.ok_or("no such camera")?;
                        let pixel = camera.project(&lamp.into()).ok_or("behind the camera")?;
                        Ok(Ok(spot(&request.camera, pixel.x, pixel.y)))
                    },
                )
            }
            Calibrate::CODE => {
                let detail = |request: &Calibrate| request.camera.clone();
                let meet = (refuse::<Calibration> as Meet<Calibrate>, Outcome::Fault);
                self.0
                    .play(cx, message, 1.0, detail, meet, |_, request: Calibrate| {
                        let mut rng = ChaCha8Rng::seed_from_u64(request.seed);
                        calibrate(&request.points, request.width, request.height, &mut rng)
                            .map_err(|error| error.to_string())
                    })
            }
            _ => cx.default_processing(message),
        }
    }
}

pub(super) struct Lamp(pub(super) StandIn);

impl EventHandler for Lamp {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            SetLamp::CODE => {
                let detail = |request: &SetLamp| request.on.to_string();
                let meet = (refuse::<()> as Meet<SetLamp>, Outcome::Fault);
                self.0
                    .play(cx, message, 0.1, detail, meet, |world, request: SetLamp| {
                        world.lamp_on = request.on;
                        Ok(())
                    })
            }
            TrueCameras::CODE => {
                let meet = (
                    refuse::<Vec<NamedCamera>> as Meet<TrueCameras>,
                    Outcome::Fault,
                );
                self.0
                    .play::<TrueCameras>(cx, message, 0.1, none, meet, |_, _| {
                        let named = |(name, camera): (&str, Camera)| NamedCamera {
                            name: name.to_owned(),
                            camera,
                        };
                        Ok(cameras().map(named).into())
                    })
            }
            _ => cx.default_processing(message),
        }
    }
}

/// The real DOM, which fails on demand.
pub(super) struct FaultyDom(pub(super) StandIn, pub(super) Dom);

impl EventHandler for FaultyDom {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        let commands: [CommandInfo; 4] = [
            PutData::INFO,
            PutAll::INFO,
            GetData::INFO,
            SetValidity::INFO,
        ];
        let known = commands.iter().find(|info| info.code == message.command());
        let answer = known.map_or(Answer::Work, |info| self.0.answer(info.name, ""));
        match answer {
            Answer::Work => self.1.handle(cx, message).await,
            Answer::Silent => Ok(()),
            _ => Err("the DOM refused on purpose".into()),
        }
    }
}
