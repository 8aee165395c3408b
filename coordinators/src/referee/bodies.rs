//! Referees of tasks that move bodies: they hold what was told against where the bodies are, which only a stand-in for the world
//! can know. They run when everything is done; nothing that plans may ask them.

use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings},
    message::{Command, Message},
    registry::Registry,
    system::AppResult,
    task::{Context, EventHandler, Handled, HandlerError},
};
use mcs_hand::command::{Body, ReadBodies};
use nalgebra::{Isometry3, Matrix4};
use serde::de::DeserializeOwned;

use super::Judge;
use crate::dom::DomStore;

/// The arguments of such a referee, and how it judges.
pub(crate) trait Judges: DeserializeOwned + 'static {
    /// The handler's name.
    const HANDLER: &'static str;

    /// The task that knows where bodies are.
    fn world(&self) -> &str;

    /// The task of the data object manager.
    fn dom(&self) -> &str;

    /// Findings where the arguments make no sense. That both tasks are there is checked besides.
    fn check(&self, task: &TaskConfig, findings: &mut Findings);

    /// The verdict.
    async fn judge(
        &self,
        cx: &Context,
        store: &DomStore,
        bodies: &[Body],
        judge: &Judge,
    ) -> Result<AppResult, HandlerError>;
}

/// The task that knows where bodies are, unless arguments say otherwise.
pub(crate) fn world_task() -> String {
    "world".to_owned()
}

/// Registers the handler.
pub(crate) fn register<R: Judges>(registry: &mut Registry) {
    registry
        .handler(R::HANDLER, &[Judge::INFO], |cx| {
            Ok(Referee::<R> { args: cx.args()? })
        })
        .checked_args::<R>(|args, task: &TaskConfig, app: &App, findings| {
            crate::need_task(task, app, "world", args.world(), findings);
            crate::need_task(task, app, "dom", args.dom(), findings);
            args.check(task, findings);
        });
}

/// A finding when a length is none that a referee can go by.
pub(crate) fn check_length(
    task: &TaskConfig,
    (key, value, most): (&str, f64, f64),
    code: &'static str,
    findings: &mut Findings,
) {
    if !(1e-5..=most).contains(&value) {
        let place = task.args.locate(key).unwrap_or_else(|| task.place.clone());
        findings.push(
            Finding::error(code, format!("`{key}` is {value}"))
                .at(place)
                .help(format!("give from 0.00001 to {most} m")),
        );
    }
}

/// `base_t_body`.
///
/// # Errors
/// The world has no such body.
pub(crate) fn pose_of(bodies: &[Body], name: &str) -> Result<Isometry3<f64>, HandlerError> {
    let body = bodies.iter().find(|body| body.name == name);
    let body = body.ok_or_else(|| {
        let names: Vec<&str> = bodies.iter().map(|body| body.name.as_str()).collect();
        HandlerError::new(format!(
            "the world has no body `{name}`; it has {}",
            names.join(", ")
        ))
    })?;
    nalgebra::try_convert(Matrix4::from_row_slice(&body.world_t_body))
        .ok_or_else(|| HandlerError::new(format!("the pose of `{name}` is none")))
}

struct Referee<R> {
    args: R,
}

impl<R: Judges> Referee<R> {
    async fn judge(&self, cx: &Context, judge: &Judge) -> Result<AppResult, HandlerError> {
        let store = DomStore::new(self.args.dom());
        let world = cx.task(self.args.world()).await?;
        let bodies = cx.call(&world, ReadBodies {}).await;
        let bodies = bodies.map_err(|error| HandlerError::new(error.reason()))?;
        self.args.judge(cx, &store, &bodies, judge).await
    }
}

impl<R: Judges> EventHandler for Referee<R> {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            Judge::CODE => {
                let (judge, reply) = message.open::<Judge>()?;
                match self.judge(cx, &judge).await {
                    Ok(result) => reply.ok(result),
                    Err(error) => reply.fail(error),
                }
            }
            _ => cx.default_processing(message),
        }
    }
}
