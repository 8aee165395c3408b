//! vmLaser: one laser scanner, which some other task of the app drives. It takes orders under a grant of the manager, and is off when
//! the chassis of whoever steered it has died.

use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings},
    message::{ChassisNumber, Command, CommandInfo, Message},
    task::{Context, EventHandler, Handled, HandlerError},
};
use serde::Deserialize;

use crate::{
    command::{InitializeVm, OrderLaser, SteerLaser},
    laser::LaserOrder,
    vmm::number_of,
};

/// The commands of `vss.vm_laser`.
pub const LASER_COMMANDS: &[CommandInfo] = &[InitializeVm::INFO, SteerLaser::INFO];

/// Its arguments: the table of the scanner, and its name, which the catalog writes.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct LaserArgs {
    /// The scanner's name, as its driver knows it.
    laser: String,
    /// The task that drives it.
    task: String,
}

/// The task that drives the scanner must be one of the app.
pub(crate) fn driver_of(task: &TaskConfig, app: &App, findings: &mut Findings) {
    let Ok(LaserArgs {
        laser,
        task: driver,
    }) = task.args.parse::<LaserArgs>()
    else {
        // That is told elsewhere.
        return;
    };
    let known: Vec<&str> = app.tasks.iter().map(|task| task.name.as_str()).collect();
    if !known.contains(&driver.as_str()) {
        let text = format!("there is no task `{driver}`, which drives the scanner `{laser}`");
        let place = task
            .args
            .locate("task")
            .unwrap_or_else(|| task.place.clone());
        let finding = Finding::error("vss::args::scanner", text).at(place);
        findings.push(finding.suggest(&driver, known));
    }
}

/// vmLaser: one laser scanner.
#[derive(Debug)]
pub struct LaserModule {
    args: LaserArgs,
    /// The last grant under which it was steered.
    grant: u64,
    /// The chassis of whoever has it lit.
    lit_by: Option<ChassisNumber>,
}

impl LaserModule {
    pub(crate) fn new(cx: &Context) -> Result<Self, HandlerError> {
        Ok(Self {
            args: cx.args()?,
            grant: 0,
            lit_by: None,
        })
    }

    async fn order(&self, cx: &Context, order: LaserOrder) -> Result<(), HandlerError> {
        let driver = cx.task(&self.args.task).await?;
        let laser = self.args.laser.clone();
        let done = cx.call(&driver, OrderLaser { laser, order }).await;
        done.map_err(|error| HandlerError::new(error.reason()))
    }
}

impl EventHandler for LaserModule {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            InitializeVm::CODE => message.open::<InitializeVm>()?.1.ok(()),
            SteerLaser::CODE => {
                let from = message.from().chassis();
                let (SteerLaser { grant, order }, reply) = message.open::<SteerLaser>()?;
                if grant < self.grant {
                    let laser = &self.args.laser;
                    return reply.fail(format!(
                        "another client has the scanner `{laser}` now: it was lost by holding it for longer than the manager allows \
                         while others wait (hold_limit_s)"
                    ));
                }
                self.grant = grant;
                match self.order(cx, order).await {
                    Ok(()) => {
                        self.lit_by = (order != LaserOrder::Off).then_some(from);
                        reply.ok(())
                    }
                    Err(error) => reply.fail(error),
                }
            }
            _ => cx.default_processing(message),
        }
    }

    async fn chassis_down(&mut self, cx: &Context, chassis: &str) -> Handled {
        if self.lit_by.is_some() && self.lit_by == number_of(cx, chassis) {
            let laser = &self.args.laser;
            tracing::warn!(laser, chassis, "off: whoever had it lit is gone");
            self.lit_by = None;
            self.order(cx, LaserOrder::Off).await?;
        }
        Ok(())
    }
}
