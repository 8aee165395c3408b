//! The event handler `mcs.path`: plans ways for the arm of a servo, for whoever asks. It moves nothing.
//!
//! The arm and what there is around it are those of the servo's own guard of the kind `collision`, so that who plans and who
//! watches mean the same. It needs nothing of the servo itself: it may run on any processor of any chassis.

use std::sync::Arc;
use std::time::Duration;

use ctos::config::{App, TaskConfig};
use ctos::diagnostic::{Finding, Findings};
use ctos::message::{Command, Message};
use ctos::registry::Registry;
use ctos::task::{Context, EventHandler, Handled, HandlerError};
use mcs::Joints;
use mcs::client::Plan;
use mcs::model::Model;
use mcs::trajectory::Planner;
use mcs_collision::guard::{KIND, Surroundings};
use serde::{Deserialize, Serialize};

use crate::ahead::{self, Refused};
use crate::search::{End, Options, PathError, Search, within_limits};
use crate::space::{Space, Touch};
use crate::way::Way;

/// Its registered name.
pub const HANDLER: &str = "mcs.path";

/// So many random positions are tried before others of its processor have their turn.
const AT_ONCE: u32 = 25;
/// How long the turn of the others is.
const TURN: Duration = Duration::from_millis(1);

/// Why no way was planned.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, thiserror::Error)]
pub enum Unplanned {
    /// There is none, or none was found.
    #[error(transparent)]
    Path(#[from] PathError),
    /// It took too long.
    #[error(
        "no way was found within {within_s} s, with {iterations} random positions: give `within_s` more, or look whether there is one"
    )]
    Late {
        /// The time there was, s.
        within_s: f64,
        /// Random positions that were tried.
        iterations: u32,
    },
    /// Where the other arms stand was not said for all of them.
    #[error(
        "the recipe of the collision guard has {needed} other arms, and where {given} of them stand was said"
    )]
    Others {
        /// Other arms of the recipe.
        needed: usize,
        /// Positions given.
        given: usize,
    },
    /// Motions may not be made.
    #[error(transparent)]
    Refused(#[from] Refused),
    /// The app is being stopped.
    #[error("the app is being stopped")]
    Stopping,
}

/// What was planned.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Planned {
    /// The way.
    pub way: Way,
    /// Random positions that were tried; 0 of a way that is straight.
    pub iterations: u32,
}

ctos::command! {
    /// Plans a way of the arm that touches nothing. Moves nothing.
    #[derive(Debug, Clone, PartialEq)]
    pub struct PlanWay {
        /// Joint positions where it begins, rad or m.
        pub from: Joints,
        /// Where it may end: whichever is found first.
        pub goals: Vec<Joints>,
        /// Where the other arms stand, in the order of the recipe: their joint positions, rad or m.
        pub others: Vec<Joints>,
        /// The same seed finds the same way; that of the task's arguments when it is left out.
        pub seed: Option<u64>,
    } => Result<Planned, Unplanned>, 0x0470, "plan_way"
}
ctos::command! {
    /// Tells which solids are nearest to one another at a position of the arm, and how near, m.
    #[derive(Debug, Clone, PartialEq)]
    pub struct ReadNearest {
        /// Joint positions, rad or m.
        pub at: Joints,
        /// As in [`PlanWay`].
        pub others: Vec<Joints>,
    } => Result<Option<Touch>, Unplanned>, 0x0471, "read_nearest"
}

ctos::command! {
    /// Looks ahead along motions that would be made one after another: whether the recipe's guard would let each of them pass while
    /// nothing else moves. Answers where they end, rad or m. Moves nothing.
    #[derive(Debug, Clone, PartialEq)]
    pub struct LookAhead {
        /// Joint positions where the first one begins, rad or m.
        pub from: Joints,
        /// The motions.
        pub motions: Vec<Plan>,
        /// As in [`PlanWay`].
        pub others: Vec<Joints>,
    } => Result<Joints, Unplanned>, 0x0472, "look_ahead"
}

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Args {
    /// The servo task whose arm it plans for; it may be on another chassis.
    servo: String,
    /// The recipe of its guard of the kind `collision` that says what there is around it.
    #[serde(default = "guard")]
    guard: String,
    /// The distance that is kept besides the guard's own margin, m: room for what the guard counts with, a way to rest
    /// straight on.
    #[serde(default = "room_m")]
    room_m: f64,
    /// The same where it looks ahead along motions; not where the recipe has `near`.
    #[serde(default = "ahead_m")]
    ahead_m: f64,
    /// Random positions that are tried before it is given up.
    #[serde(default = "iterations")]
    iterations: u32,
    /// Time after which it is given up, s.
    #[serde(default = "within_s")]
    within_s: f64,
    /// The seed.
    #[serde(default = "seed")]
    seed: u64,
}

fn guard() -> String {
    KIND.to_owned()
}

fn room_m() -> f64 {
    0.02
}

fn ahead_m() -> f64 {
    0.005
}

fn iterations() -> u32 {
    Options::default().iterations
}

fn within_s() -> f64 {
    10.0
}

fn seed() -> u64 {
    Options::default().seed
}

/// The arm of a servo and what there is around it.
struct World {
    model: Arc<Model>,
    /// As the servo's own.
    planner: Planner,
    around: Surroundings,
    /// The other arms, in the order of the recipe.
    others: Vec<Arc<Model>>,
}

impl World {
    /// # Errors
    /// What the app does not have, or has wrong; each with its place if it has one.
    fn read(args: &Args, app: &App) -> Result<Self, Wrong> {
        let servo = app.task(&args.servo).ok_or_else(|| Wrong {
            key: "servo",
            text: format!("the app has no task `{}`", args.servo),
            near: args.servo.clone(),
            known: app.tasks.iter().map(|task| task.name.clone()).collect(),
        })?;
        let model = mcs::arm(servo, app).ok_or_else(|| {
            let text = format!("what task `{}` drives is no arm", args.servo);
            Wrong::plain("servo", text)
        })?;
        let planner = mcs::planner(servo, app).ok_or_else(|| {
            let text = format!("the arguments of task `{}` are wrong", args.servo);
            Wrong::plain("servo", text)
        })?;
        let guards = servo.args.get("guards");
        let recipe = guards.and_then(|guards| guards.get(&args.guard));
        let kind = recipe.and_then(|recipe| recipe.get("kind")?.as_str());
        if kind != Some(KIND) {
            let recipes = guards.map(|guards| guards.entries()).unwrap_or_default();
            return Err(Wrong {
                key: "guard",
                text: format!(
                    "`{}` has no guard `{}` of the kind `{KIND}`",
                    args.servo, args.guard
                ),
                near: args.guard.clone(),
                known: recipes.iter().map(|entry| entry.key.clone()).collect(),
            });
        }
        // A recipe without arguments has an arm alone in an empty room.
        let none = ctos::config::Node::table();
        let around = recipe
            .and_then(|recipe| recipe.get("args"))
            .unwrap_or(&none);
        let around = Surroundings::read(around);
        let around = around.map_err(|error| Wrong::plain("guard", error.to_string()))?;
        let others = around.others.iter().map(|(servo, _)| {
            let arm = app.task(servo).and_then(|task| mcs::arm(task, app));
            arm.map(Arc::new).ok_or_else(|| {
                let text = format!("task `{servo}` of the recipe drives no arm");
                Wrong::plain("guard", text)
            })
        });
        Ok(Self {
            model: Arc::new(model),
            planner,
            others: others.collect::<Result<_, _>>()?,
            around,
        })
    }

    fn space(&self, others: &[Joints], room_m: f64) -> Result<Space, Unplanned> {
        let (needed, given) = (self.others.len(), others.len());
        let fit = self.others.iter().zip(others);
        let fit = fit.filter(|(model, at)| model.dof() == at.len()).count();
        if needed != given || fit != needed {
            return Err(Unplanned::Others { needed, given: fit });
        }
        let placed = self.others.iter().zip(&self.around.others).zip(others);
        let placed = placed.map(|((model, (_, at)), joints)| (Arc::clone(model), *at, *joints));
        Ok(Space::new(
            Arc::clone(&self.model),
            placed.collect(),
            self.around.room.clone(),
            self.around.margin + room_m,
        ))
    }
}

/// What is wrong with an argument.
struct Wrong {
    key: &'static str,
    text: String,
    near: String,
    known: Vec<String>,
}

impl Wrong {
    fn plain(key: &'static str, text: String) -> Self {
        Self {
            key,
            text,
            near: String::new(),
            known: Vec::new(),
        }
    }
}

struct Paths {
    args: Args,
    world: World,
    /// What one looks ahead in, with where the other arms stand: it takes long to make.
    ahead: Option<(Vec<Joints>, Space)>,
}

/// Makes the handler known.
pub(crate) fn register(registry: &mut Registry) {
    registry
        .handler(
            HANDLER,
            &[PlanWay::INFO, ReadNearest::INFO, LookAhead::INFO],
            |cx| {
                let args: Args = cx.args()?;
                let world = World::read(&args, cx.app());
                let world = world.map_err(|wrong| HandlerError::new(wrong.text))?;
                Ok(Paths {
                    args,
                    world,
                    ahead: None,
                })
            },
        )
        .checked_args::<Args>(check);
}

fn check(args: &Args, task: &TaskConfig, app: &App, findings: &mut Findings) {
    let place = |key: &str| task.args.locate(key).unwrap_or_else(|| task.place.clone());
    let numbers = [
        ("room_m", args.room_m, 0.0, 1.0),
        ("ahead_m", args.ahead_m, 0.0, 1.0),
        ("iterations", f64::from(args.iterations), 1.0, 1e6),
        ("within_s", args.within_s, 1e-3, 3600.0),
    ];
    for (key, value, low, high) in numbers {
        if !(low..=high).contains(&value) {
            let finding = Finding::error("mcs::out_of_range", format!("`{key}` is {value}"));
            let help = format!("give a value from {low} to {high}");
            findings.push(finding.at(place(key)).help(help));
        }
    }
    if let Err(wrong) = World::read(args, app) {
        let finding = Finding::error("mcs::unknown_part", wrong.text).at(place(wrong.key));
        let known = wrong.known.iter().map(String::as_str);
        findings.push(finding.suggest(&wrong.near, known));
    }
}

impl Paths {
    async fn plan(&self, cx: &Context, ask: &PlanWay) -> Result<Planned, Unplanned> {
        let Args {
            room_m,
            iterations,
            within_s,
            ..
        } = self.args;
        let space = self.world.space(&ask.others, room_m)?;
        let options = Options {
            seed: ask.seed.unwrap_or(self.args.seed),
            iterations,
            ..Options::default()
        };
        let mut search = Search::new(space, &ask.from, &ask.goals, options)?;
        // `within_s` is checked to be a number of seconds.
        let until = cx.now() + Duration::try_from_secs_f64(within_s).unwrap_or(Duration::MAX);
        loop {
            if let Some(way) = search.advance(AT_ONCE)? {
                return Ok(Planned {
                    way,
                    iterations: search.tried(),
                });
            }
            if cx.now() >= until {
                return Err(Unplanned::Late {
                    within_s,
                    iterations: search.tried(),
                });
            }
            if cx.is_stopping() {
                return Err(Unplanned::Stopping);
            }
            cx.sleep(TURN).await;
        }
    }
}

/// Whether a position has a number for each joint of the arm.
fn fits(space: &Space, at: &Joints) -> Result<(), Unplanned> {
    let (needed, given) = (space.model().dof(), at.len());
    if needed == given {
        return Ok(());
    }
    let end = End::Start;
    Err(PathError::Count { end, needed, given }.into())
}

impl Paths {
    fn look_ahead(&mut self, ask: &LookAhead) -> Result<Joints, Unplanned> {
        let (_, space) = match self.ahead.take() {
            Some(known) if known.0 == ask.others => self.ahead.insert(known),
            _ => {
                let space = self.world.space(&ask.others, self.args.ahead_m)?;
                let space = space.with_near(&self.world.around.near);
                self.ahead.insert((ask.others.clone(), space))
            }
        };
        within_limits(space.model(), &ask.from, End::Start)?;
        let end = ahead::look(&mut self.world.planner, space, &ask.from, &ask.motions)?;
        Ok(end)
    }
}

impl EventHandler for Paths {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            PlanWay::CODE => {
                let (ask, reply) = message.open::<PlanWay>()?;
                let planned = self.plan(cx, &ask).await;
                match &planned {
                    Ok(Planned { way, iterations }) => tracing::info!(
                        task = cx.name(),
                        points = way.points.len(),
                        length_m = way.length_m,
                        iterations,
                        "a way was planned"
                    ),
                    Err(reason) => tracing::warn!(task = cx.name(), %reason, "no way was planned"),
                }
                reply.ok(planned)
            }
            ReadNearest::CODE => {
                let (ask, reply) = message.open::<ReadNearest>()?;
                let space = self.world.space(&ask.others, 0.0);
                reply.ok(space.and_then(|mut space| {
                    fits(&space, &ask.at)?;
                    Ok(space.nearest(&ask.at))
                }))
            }
            LookAhead::CODE => {
                let (ask, reply) = message.open::<LookAhead>()?;
                reply.ok(self.look_ahead(&ask))
            }
            _ => cx.default_processing(message),
        }
    }
}
