//! The servo's task: builds the channel driver, puts the synchronous function on its processor's
//! schedule, and brings the arm to rest when the app stops.

use std::collections::BTreeMap;
use std::sync::Arc;

use ctos::config::{App, Node, TaskConfig};
use ctos::diagnostic::{Finding, Findings, Place};
use ctos::message::{ChassisNumber, Command, CommandInfo, Message, Replier};
use ctos::registry::Registry;
use ctos::sync::{CyclicHandle, Tick};
use ctos::task::{Context, EventHandler, Handled, HandlerError, Phase, StopReason};
use serde::{Deserialize, Serialize};

use super::guards::{self, Maker, Recipes};
use super::records::{Recorder, Records, records};
use super::slots::{self, LastStop};
use super::split_torque;
use super::streams::Streams;
use super::ways::Ways;
use super::{Link, SERVO, rows, stands};
use crate::args::{self, RecipeArgs, ServoArgs};
use crate::client::{
    ControlReport, GuardsReport, MotionError, Outcome, ReadControl, ReadGuards, ReadSensors,
    ReadSlots, ReadStream, RecordStates, RemoveGuard, SetControl, SetGuard, SetLaw, SetOutput,
    StreamSetpoints, StreamValue,
};
use crate::control::split_torque::SPLIT_TORQUE;
use crate::control::{ControlLaw, LawRegistry, LawSettings};
use crate::driver::{DriverRegistry, SensorKind};
use crate::guard::GuardRegistry;
use crate::model::Model;
use crate::servo::{MotionPhase, Servo, ServoCommand, ServoStatus};
use crate::trajectory::{Planner, PlanningRegistry, Solver};

/// The servo's status with what only its own task knows.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ServoReport {
    /// What the latest tick left.
    pub status: ServoStatus,
    /// Why power was taken away, in the driver's words where it was the driver.
    pub fault: Option<String>,
    /// `base_t_tool` at the joint positions read back: 4 by 4, row by row, lengths in m.
    pub base_t_tool: [f64; 16],
    /// The same at the setpoint.
    pub base_t_commanded: [f64; 16],
}

/// Orders that anybody may give.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum StopKind {
    /// Brake along the path to rest, then hold until somebody resumes.
    Protective,
    /// Brake along the path to rest.
    Cancel,
    /// Brake along the path to rest, then drive power off.
    Controlled,
    /// Drive power off now.
    Emergency,
}

ctos::command! {
    /// Reads what the servo's latest tick left.
    #[derive(Debug, Clone, PartialEq)]
    pub struct ReadServo => ServoReport, 0x0321, "read_servo"
}
ctos::command! {
    /// Stops the arm.
    #[derive(Debug, Clone, PartialEq)]
    pub struct StopServo {
        /// How.
        pub kind: StopKind,
    } => (), 0x0322, "stop_servo"
}
ctos::command! {
    /// Ends a protective stop.
    #[derive(Debug, Clone, PartialEq)]
    pub struct ResumeServo => (), 0x0323, "resume_servo"
}

/// What the servo's task takes.
const COMMANDS: [CommandInfo; 16] = [
    ReadServo::INFO,
    StopServo::INFO,
    ResumeServo::INFO,
    ReadControl::INFO,
    SetControl::INFO,
    RecordStates::INFO,
    SetGuard::INFO,
    RemoveGuard::INFO,
    ReadGuards::INFO,
    SetLaw::INFO,
    ReadSensors::INFO,
    StreamSetpoints::INFO,
    StreamValue::INFO,
    ReadStream::INFO,
    SetOutput::INFO,
    ReadSlots::INFO,
];

pub(super) fn register(
    registry: &mut Registry,
    drivers: Arc<DriverRegistry>,
    laws: Arc<LawRegistry>,
    guards: Arc<GuardRegistry>,
    planning: Arc<PlanningRegistry>,
) {
    let offered = Arc::clone(&planning);
    let (known, known_laws) = (Arc::clone(&drivers), Arc::clone(&laws));
    let kinds = Arc::clone(&guards);
    registry
        .handler(SERVO, &COMMANDS, move |cx| {
            ServoTask::new(cx, &drivers, &laws, (&guards, &planning))
        })
        .checked_args::<ServoArgs>(move |args, task, app, findings| {
            check(args, (task, app), (&known, &known_laws, &kinds), findings);
            if let Some(model) = args.check(task, app, &mut Findings::new())
                && let Err(finding) = solver((args, task), Arc::new(model), &offered)
            {
                findings.push(finding);
            }
        });
}

/// The arguments that a driver or a law has of its own.
fn own_args(task: &TaskConfig, key: &str) -> Node {
    task.args.get(key).cloned().unwrap_or_else(Node::table)
}

fn place(task: &TaskConfig, key: &str) -> Place {
    task.args.locate(key).unwrap_or_else(|| task.place.clone())
}

fn check(
    args: &ServoArgs,
    (task, app): (&TaskConfig, &App),
    (drivers, laws, guards): (&DriverRegistry, &LawRegistry, &Arc<GuardRegistry>),
    findings: &mut Findings,
) {
    let model = args.check(task, app, findings).map(Arc::new);
    if let Some(model) = &model {
        let maker = Maker {
            kinds: Arc::clone(guards),
            model: Arc::clone(model),
            period: args.config().period,
            servo: task.name.clone(),
        };
        maker.check(args, task, app, findings);
        stands::check(args, model, (task, app), findings);
        let others = own_args(task, "laws");
        let others = others.entries().iter().map(|entry| &entry.key);
        for name in std::iter::once(&args.law).chain(others) {
            if let Err(finding) = law(name, (args, task, None), model, laws) {
                findings.push(finding);
            }
        }
        check_halves(args, task, app, findings);
    }
    let kind = match drivers.find(&args.driver, &task.name) {
        Ok(kind) => kind,
        Err(finding) => return findings.push(finding.at(place(task, "driver"))),
    };
    let driver_args = own_args(task, "driver_args");
    kind.run_check(task, app, &driver_args, findings);
    if let (Some(model), Some(slots)) = (model, kind.count_slots(app, &driver_args))
        && slots != model.dof()
    {
        let text = format!(
            "task `{}`: the channel driver `{}` has {slots} slots, and the arm `{}` has {} joints",
            task.name,
            args.driver,
            model.name(),
            model.dof()
        );
        let finding = Finding::error("mcs::servo::slots", text).at(place(task, "driver"));
        findings.push(finding.help("name another driver, or another `model`"));
    }
}

/// A law on two processors needs a task for its other half.
fn check_halves(args: &ServoArgs, task: &TaskConfig, app: &App, findings: &mut Findings) {
    let is_half = |other: &TaskConfig| {
        let servo = other.args.get("servo").and_then(Node::as_str);
        other.handler == split_torque::SPLIT_TORQUE && servo == Some(&task.name)
    };
    if args.law == SPLIT_TORQUE && !app.tasks.iter().any(is_half) {
        let text = format!("the law of task `{}` has no other half", task.name);
        let finding = Finding::error("mcs::servo::law", text).at(place(task, "law"));
        findings.push(finding.help(format!(
            "add a task on another processor of the chassis, with `handler = \"{}\"` and `args.servo = \"{}\"`",
            split_torque::SPLIT_TORQUE,
            task.name
        )));
    }
}

/// The control law of that name, with the arguments that the task has for it: `law_args` for its own law, else those in
/// `laws`.
fn law(
    name: &str,
    (args, task, cx): (&ServoArgs, &TaskConfig, Option<&Context>),
    model: &Arc<Model>,
    laws: &LawRegistry,
) -> Result<Box<dyn ControlLaw>, Finding> {
    let own = name == args.law;
    let key = match own {
        true => "law_args".to_owned(),
        false => format!("laws.\"{name}\""),
    };
    let settings = LawSettings {
        model,
        bandwidth_hz: args.bandwidth_hz,
        damping: args.damping,
        period: args.config().period,
        cx,
        args: &own_args(task, &key),
    };
    match laws.build(name, &settings) {
        Some(law) => law.map_err(|error| {
            let text = format!("control law `{name}`: {error}");
            Finding::error("mcs::servo::law", text).at(place(task, &key))
        }),
        None => {
            let text = format!(
                "task `{}` names the control law `{name}`, which nobody registered",
                task.name
            );
            let at = place(task, if own { "law" } else { &key });
            let finding = Finding::error("mcs::servo::unknown_law", text).at(at);
            Err(finding.suggest(name, laws.names()))
        }
    }
}

/// The solver of inverse kinematics that the arguments name.
fn solver(
    (args, task): (&ServoArgs, &TaskConfig),
    model: Arc<Model>,
    planning: &PlanningRegistry,
) -> Result<Solver, Finding> {
    let wrong = |code: &'static str, text: String| {
        Finding::error(code, format!("task `{}`: {text}", task.name)).at(place(task, "inverse"))
    };
    let found = match &args.inverse {
        None => Solver::new(model),
        Some(name) => match planning.solver(name, &model) {
            Some(Some(inverse)) => Solver::by(model, inverse),
            Some(None) => {
                let text = format!("the solver `{name}` is not for the arm `{}`", model.name());
                let finding = wrong("mcs::servo::inverse", text);
                return Err(finding.help("name another one, or leave `inverse` out"));
            }
            None => {
                let text = format!("nobody registered the solver of inverse kinematics `{name}`");
                let finding = wrong("mcs::servo::unknown_inverse", text);
                return Err(finding.suggest(name, planning.solvers()));
            }
        },
    };
    found.map_err(|error| wrong("mcs::servo::inverse", error.to_string()))
}

struct ServoTask {
    link: Arc<Link>,
    /// Knows where the tool is.
    planner: Planner,
    /// Wait here for the first phase.
    ticking: Option<(Servo, Recorder)>,
    records: Records,
    cyclic: Option<CyclicHandle>,
    control: ControlReport,
    guards: Maker,
    /// The recipes of the configuration, until all servos of the chassis are there.
    recipes: BTreeMap<String, RecipeArgs>,
    laws: Arc<LawRegistry>,
    model: Arc<Model>,
    args: ServoArgs,
    streams: Streams,
    /// The number of the chassis of the client interface that last asked for a stream.
    streamed_from: Option<ChassisNumber>,
    last_stop: LastStop,
}

impl ServoTask {
    fn new(
        cx: &Context,
        drivers: &DriverRegistry,
        laws: &Arc<LawRegistry>,
        (guards, planning): (&Arc<GuardRegistry>, &Arc<PlanningRegistry>),
    ) -> Result<Self, HandlerError> {
        let task = cx.config().ok_or("a servo task needs a configuration")?;
        let mut findings = Findings::new();
        let read = ServoArgs::read(task, cx.app(), &mut findings);
        let (args, model) = read.ok_or_else(|| findings.to_string())?;
        let model = Arc::new(model);
        let kind = drivers.find(&args.driver, &task.name)?;
        let driver = kind.build(cx, &own_args(task, "driver_args"))?;
        let sensors = driver.sensors().to_vec();
        let config = args.config();
        let law = law(&args.law, (&args, task, Some(cx)), &model, laws)?;
        let (mut servo, port) = Servo::new(Arc::clone(&model), driver, law, config)?;
        servo.show_on(guards::board(cx, &model));
        let solver = solver((&args, task), Arc::clone(&model), planning)?;
        servo.solve_by(solver.clone());
        let guards = Maker {
            kinds: Arc::clone(guards),
            model: Arc::clone(&model),
            period: config.period,
            servo: cx.name().to_owned(),
        };
        let setpoint_period = config.period.as_secs_f64() * f64::from(config.setpoint_every);
        let planner = Planner::new(Arc::clone(&model), args.cartesian, setpoint_period)?;
        let planner = planner.limiting_jerk(args.limit_jerk).solving_by(solver);
        let planner = planner.offering(Arc::clone(planning));
        let (records, recorder) = records(planner.model().dof(), &sensors);
        let link = Arc::new(Link {
            port,
            planner: planner.clone(),
            config,
            guards: Recipes::default(),
            ways: Ways::default(),
            stands: args.stands.clone(),
            sensor_frames: args.sensor_frames.clone(),
            sensors,
        });
        cx.share(&Link::key(cx.name()), Arc::clone(&link));
        Ok(Self {
            link,
            planner,
            ticking: Some((servo, recorder)),
            records,
            cyclic: None,
            guards,
            recipes: args.guards.clone(),
            control: ControlReport {
                law: args.law.clone(),
                bandwidth_hz: args.bandwidth_hz,
                damping: args.damping,
                following_error_rad: args.following_error_rad,
            },
            laws: Arc::clone(laws),
            model,
            args,
            streams: Streams::default(),
            streamed_from: None,
            last_stop: LastStop::default(),
        })
    }

    fn report(&mut self) -> ServoReport {
        let status = self.link.port.status();
        self.last_stop.see(&status, self.link.fault());
        ServoReport {
            status,
            fault: self.link.fault(),
            base_t_tool: rows(&self.planner.tool_pose(&status.position)),
            base_t_commanded: rows(&self.planner.tool_pose(&status.setpoint)),
        }
    }

    /// Answers when the servo shows that it has obeyed. Further orders are taken meanwhile.
    fn confirm<C: Command<Reply = ()>>(
        &self,
        cx: &Context,
        reply: Replier<C>,
        obeyed: impl Fn(&ServoStatus) -> bool + 'static,
    ) -> Handled {
        let (own, link) = (cx.clone(), Arc::clone(&self.link));
        cx.spawn(async move {
            let patience = link.rest_patience();
            // Answering never fails; its result exists to end a handler with.
            let _ = match link.wait(&own, "obey", patience, obeyed).await {
                Ok(_) => reply.ok(()),
                Err(error) => reply.fail(error),
            };
        });
        Ok(())
    }

    /// Answers when a tick has begun after the order was given.
    fn confirm_tick<C: Command<Reply = ()>>(&self, cx: &Context, reply: Replier<C>) -> Handled {
        let before = self.link.port.status().ticks;
        // The tick that was under way may have ended without having seen it.
        self.confirm(cx, reply, move |status| status.ticks > before + 1)
    }

    /// Gives the control law other parameters, when they can be and nothing moves.
    fn tune(&mut self, request: &SetControl) -> Result<ControlReport, HandlerError> {
        let most_hz = args::most_bandwidth_hz(self.link.config.period);
        let given = [
            ("bandwidth_hz", request.bandwidth_hz, 0.1, most_hz),
            ("damping", request.damping, 0.1, 5.0),
        ];
        for (what, value, low, high) in given {
            if !(low..=high).contains(&value) {
                return Err(format!("`{what}` is {low} to {high:.3}, not {value}").into());
            }
        }
        if !self.link.port.status().motion.phase.is_over() {
            return Err(
                "the arm is on its way; set the control parameters when it has arrived".into(),
            );
        }
        self.link.port.order(ServoCommand::Tune {
            bandwidth: request.bandwidth_hz,
            damping: request.damping,
        })?;
        self.control.bandwidth_hz = request.bandwidth_hz;
        self.control.damping = request.damping;
        Ok(self.control.clone())
    }

    /// Writes state records to another buffer, or to none, and frees the one before.
    async fn record(&mut self, cx: &Context, request: &RecordStates) -> Handled {
        let buffer = (cx.app().name.as_str(), request.buffer.as_deref());
        let model = self.planner.model();
        self.records.write_to(buffer, model, cx.chassis().clock())?;
        // The tick under way may still write to the one before; the next one does not.
        let before = self.link.port.status().ticks;
        let obeyed = move |status: &ServoStatus| status.ticks > before + 1;
        let patience = self.link.rest_patience();
        self.link
            .wait(cx, "write records", patience, obeyed)
            .await?;
        self.records.free();
        Ok(())
    }

    /// Goes over to another law, with the present bandwidth and damping.
    fn change_law(&mut self, cx: &Context, name: String) -> Result<ControlReport, HandlerError> {
        let task = cx.config().ok_or("a servo task needs a configuration")?;
        self.args.bandwidth_hz = self.control.bandwidth_hz;
        self.args.damping = self.control.damping;
        let law = law(&name, (&self.args, task, Some(cx)), &self.model, &self.laws)?;
        self.link.port.change_law(law)?;
        self.control.law = name;
        Ok(self.control.clone())
    }

    /// Sets an output by its name.
    fn set_output(&self, request: &SetOutput) -> Result<(), MotionError> {
        let SetOutput { name, value } = request;
        let refused = |text: String| Err(MotionError::new(Outcome::Refused, text));
        let mut number = 0;
        for sensor in &self.link.sensors {
            if sensor.name != *name {
                number += sensor.kind.width();
                continue;
            }
            if !sensor.kind.is_output() {
                return refused(format!("slot `{name}` is read, and not set"));
            }
            let lamp = sensor.kind == SensorKind::Lamp && (0.0..=1.0).contains(value);
            if !lamp && *value != 0.0 && *value != 1.0 {
                let fit = match sensor.kind {
                    SensorKind::Lamp => "0 to 1",
                    _ => "0 or 1",
                };
                return refused(format!("output `{name}` is set to {fit}, not {value}"));
            }
            let value = *value;
            let order = self
                .link
                .port
                .order(ServoCommand::SetOutput { number, value });
            return order.map_err(|error| MotionError::new(Outcome::Fault, error));
        }
        let outputs = self
            .link
            .sensors
            .iter()
            .filter(|sensor| sensor.kind.is_output());
        let names: Vec<&str> = outputs.map(|sensor| sensor.name.as_str()).collect();
        let there = match names.as_slice() {
            [] => "the manipulator has no outputs".to_owned(),
            names => format!("there are: {}", names.join(", ")),
        };
        refused(format!("there is no output `{name}`; {there}"))
    }

    /// Rest, brakes, power off. With the loop not on schedule there is nothing that could move.
    async fn shut_down(&self, cx: &Context) -> Handled {
        if self.cyclic.is_some() {
            self.link.shut_down(cx).await?;
        }
        Ok(())
    }
}

impl EventHandler for ServoTask {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            ReadServo::CODE => {
                let (ReadServo {}, reply) = message.open::<ReadServo>()?;
                reply.ok(self.report())
            }
            StopServo::CODE => {
                let (StopServo { kind }, reply) = message.open::<StopServo>()?;
                let (port, stop) = (&self.link.port, &mut self.last_stop);
                match kind {
                    StopKind::Protective => {
                        port.order(ServoCommand::Stop)?;
                        stop.asked("a protective stop was asked for");
                    }
                    // The next motion may begin at once: it is no stop to be told of.
                    StopKind::Cancel => port.order(ServoCommand::Cancel)?,
                    StopKind::Controlled => {
                        port.order(ServoCommand::ControlledStop)?;
                        stop.asked("a controlled stop was asked for");
                    }
                    StopKind::Emergency => {
                        port.emergency_stop();
                        stop.asked("emergency stop was asked for");
                    }
                }
                self.confirm(cx, reply, move |status| match kind {
                    StopKind::Protective => status.stopped || status.fault.is_some(),
                    StopKind::Cancel => status.motion.phase != MotionPhase::Moving,
                    StopKind::Controlled | StopKind::Emergency => status.fault.is_some(),
                })
            }
            ResumeServo::CODE => {
                let (ResumeServo {}, reply) = message.open::<ResumeServo>()?;
                self.link.port.order(ServoCommand::Resume)?;
                self.confirm(cx, reply, |status| !status.stopped)
            }
            RecordStates::CODE => {
                let (request, reply) = message.open::<RecordStates>()?;
                match self.record(cx, &request).await {
                    Ok(()) => reply.ok(()),
                    Err(error) => reply.fail(error),
                }
            }
            ReadControl::CODE => {
                let (ReadControl {}, reply) = message.open::<ReadControl>()?;
                reply.ok(self.control.clone())
            }
            SetControl::CODE => {
                let (request, reply) = message.open::<SetControl>()?;
                match self.tune(&request) {
                    Ok(control) => reply.ok(control),
                    Err(error) => reply.fail(error),
                }
            }
            SetGuard::CODE => {
                let (request, reply) = message.open::<SetGuard>()?;
                self.guards.set(cx, &self.link, request)?;
                self.confirm_tick(cx, reply)
            }
            RemoveGuard::CODE => {
                let (RemoveGuard { name }, reply) = message.open::<RemoveGuard>()?;
                self.guards.remove(&self.link, &name)?;
                self.confirm_tick(cx, reply)
            }
            ReadGuards::CODE => {
                let (ReadGuards {}, reply) = message.open::<ReadGuards>()?;
                reply.ok(GuardsReport {
                    recipes: self.link.guards.all(),
                    last: self.link.port.status().guard,
                })
            }
            ReadSensors::CODE => {
                let (ReadSensors {}, reply) = message.open::<ReadSensors>()?;
                let status = self.link.port.status();
                reply.ok(slots::sensor_report(&status, &self.link.sensors))
            }
            StreamSetpoints::CODE => {
                self.streamed_from = Some(message.from().chassis());
                let (request, reply) = message.open::<StreamSetpoints>()?;
                let arm = (&*self.link, &*self.model);
                reply.ok(self.streams.begin(cx, arm, request).await)
            }
            StreamValue::CODE => {
                let (value, reply) = message.open::<StreamValue>()?;
                reply.ok(self.streams.put(cx, &self.link, &value))
            }
            ReadStream::CODE => {
                let (ReadStream {}, reply) = message.open::<ReadStream>()?;
                reply.ok(self.streams.report(&self.link))
            }
            SetOutput::CODE => {
                let (request, reply) = message.open::<SetOutput>()?;
                reply.ok(self.set_output(&request))
            }
            ReadSlots::CODE => {
                let (ReadSlots {}, reply) = message.open::<ReadSlots>()?;
                let status = self.link.port.status();
                let last_stop = self.last_stop.see(&status, self.link.fault());
                reply.ok(slots::report(
                    &self.model,
                    &status,
                    &self.link.sensors,
                    last_stop,
                ))
            }
            SetLaw::CODE => {
                let (SetLaw { law }, reply) = message.open::<SetLaw>()?;
                match self.change_law(cx, law) {
                    Ok(control) => reply.ok(control),
                    Err(error) => reply.fail(error),
                }
            }
            _ => cx.default_processing(message),
        }
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Create
            && let Some((mut servo, mut recorder)) = self.ticking.take()
        {
            let tick = move |tick: &Tick| {
                servo.tick(tick.missed);
                recorder.write(servo.status());
            };
            self.cyclic = Some(cx.cyclic(self.link.config.period, tick));
        }
        if phase == Phase::Connect {
            // Now the other arms of the chassis are there, which a guard may look at.
            let recipes = std::mem::take(&mut self.recipes);
            self.guards.mount_all(cx, &self.link, recipes)?;
            // The first reading must be there before anybody plans from it.
            let ticking = |status: &ServoStatus| status.ticks > 0;
            let patience = self.link.rest_patience();
            self.link.wait(cx, "begin", patience, ticking).await?;
        }
        Ok(())
    }

    /// Nobody could stop a stream any more whose client interface is gone.
    async fn chassis_down(&mut self, cx: &Context, chassis: &str) -> Handled {
        let from = self.streamed_from.map(|index| cx.chassis().name_of(index));
        if from.is_some_and(|from| from == chassis) && self.streams.report(&self.link).follows {
            tracing::warn!(
                task = cx.name(),
                chassis,
                "the arm comes to rest: the chassis of its client interface is gone"
            );
            self.link.port.order(ServoCommand::Cancel)?;
        }
        Ok(())
    }

    async fn stop(&mut self, cx: &Context, reason: &StopReason) -> Handled {
        if let StopReason::ChassisDown { chassis } = reason {
            tracing::warn!(
                task = cx.name(),
                chassis,
                "a chassis is gone: the arm is stopped"
            );
        }
        self.shut_down(cx).await
    }
}
