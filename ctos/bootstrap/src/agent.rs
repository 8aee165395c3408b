//! The agent: the task of each chassis that creates the configured tasks, takes in those that move there, and ends
//! the process. It also tells what is known of the tasks, and begins and ends records.

use std::{collections::BTreeMap, sync::Arc, time::Duration};

use tokio::sync::oneshot;

use crate::{
    survey::{seen, survey},
    watch::{self, Gather, Metrics},
};
use ctos_config::TaskConfig;
use ctos_core::{
    chassis::{BOOT_CHASSIS, Chassis},
    circle,
    context::{Context, TaskRef},
    envelope::Replier,
    handled::{Handled, HandlerError},
    last_messages::TaskLook,
    moving::{self, Arrivals},
    phase::StopReason,
    report::{ChassisReport, RecordReport},
    runner::{TaskSpec, start_task},
    system::{
        AnnounceUp, ChassisUp, CreateTasks, Created, Exit, Load, LookAt, MoveIn, MovedTasks, Place,
        Rebound, RegisterTid, Settle, Settled, StopTask, Survey, Transfer, Waits, WaitsFor,
    },
};
use ctos_message::Tid;
use ctos_record::{Attached, BeginRecord, EndRecord, ReadRecord};

/// Exit code of a chassis whose boot is gone.
const EXIT_ORPHAN: i32 = 5;

/// The agent's state.
#[derive(Default)]
pub(crate) struct Agent {
    tasks: Vec<TaskRef>,
    arrivals: Arrivals,
    records: Attached,
}

#[ctos_derive::handler]
impl Agent {
    #[command]
    async fn create_tasks(
        &mut self,
        cx: &Context,
        CreateTasks { first_slots }: CreateTasks,
    ) -> Result<Created, HandlerError> {
        cx.chassis().directory.start_slots_at(&first_slots);
        let created = self.create(cx).await?;
        watch::start(cx);
        Ok(created)
    }

    #[command]
    fn gather(&self, cx: &Context, _: Gather) -> Metrics {
        watch::gather_here(cx.chassis())
    }

    #[command]
    fn exit(&self, cx: &Context, order: Exit, reply: Replier<Exit>) -> Handled {
        // Before the answer, after which the boot may be gone at any moment.
        cx.chassis().set_leaving();
        reply.ok(())?;
        cx.chassis().exit(order.code);
        Ok(())
    }

    #[command]
    fn survey(&self, cx: &Context, _: Survey) -> ChassisReport {
        survey(cx.chassis())
    }

    #[command]
    fn look_at(&self, cx: &Context, LookAt { task, without }: LookAt) -> Option<TaskLook> {
        seen(cx.chassis(), task, &without)
    }

    #[command]
    fn announce_up(&self, cx: &Context, AnnounceUp { chassis }: AnnounceUp) {
        for task in cx.chassis().tasks() {
            let chassis = chassis.clone();
            cx.chassis().post_system(task.tid, ChassisUp { chassis });
        }
    }

    #[command]
    fn move_in(&mut self, cx: &Context, request: MoveIn, reply: Replier<MoveIn>) -> Handled {
        self.arrivals.expect(cx, request, reply);
        Ok(())
    }

    /// Takes what comes by the old place of a task.
    #[command]
    fn transfer(
        &self,
        cx: &Context,
        Transfer { to, what }: Transfer,
        reply: Replier<Transfer>,
    ) -> Handled {
        let chassis = cx.chassis();
        let opened = match what {
            Load::Message(message) => {
                moving::deliver(cx, to, message, reply);
                return Ok(());
            }
            Load::Sync => None,
            Load::Gate(sender) => Some(sender),
            Load::Without { old, .. } if old == chassis.index() || chassis.is_linked(old) => {
                return reply.fail("the old place may still send something");
            }
            Load::Without { chassis, .. } => Some(chassis),
        };
        if let (Some(sender), Some(task)) = (opened, chassis.task(to)) {
            task.mailbox.open_gate(sender);
        }
        reply.ok(Ok(Vec::new()))
    }

    /// A name has another id now, or none.
    #[command]
    fn rebound(&self, cx: &Context, rebound: Rebound, reply: Replier<Rebound>) -> Handled {
        if let (Some(new), true) = (rebound.new, rebound.moved) {
            let here = cx.clone();
            cx.spawn(async move {
                // A reply cannot fail.
                let _ = match moving::redirect(&here, &rebound, new).await {
                    Ok(()) => reply.ok(()),
                    Err(error) => reply.fail(error),
                };
            });
            return Ok(());
        }
        let directory = &cx.chassis().directory;
        directory.rebind(&rebound.name, rebound.old, rebound.new);
        reply.ok(())
    }

    #[command]
    fn waits_for(&self, cx: &Context, WaitsFor { task }: WaitsFor) -> Option<Waits> {
        circle::of_task(cx.chassis(), task)
    }

    #[command]
    fn begin_record(
        &mut self,
        cx: &Context,
        order: BeginRecord,
        reply: Replier<BeginRecord>,
    ) -> Handled {
        match self.records.begin(cx, order, watch::COMMANDS) {
            Ok(report) => reply.ok(report),
            Err(why) => reply.fail(why),
        }
    }

    #[command]
    fn read_record(&self, ReadRecord { key }: ReadRecord) -> Option<RecordReport> {
        self.records.read(key)
    }

    #[command]
    fn end_record(
        &mut self,
        cx: &Context,
        EndRecord { key }: EndRecord,
        reply: Replier<EndRecord>,
    ) -> Handled {
        self.records.end(cx, key, reply);
        Ok(())
    }

    #[chassis_down]
    async fn lost(&mut self, cx: &Context, chassis: &str) -> Handled {
        if let Some(peer) = cx.chassis().number_of(chassis) {
            self.arrivals.lost(cx, peer);
            for task in cx.chassis().tasks() {
                task.mailbox.forget_gate(peer);
            }
        }
        if chassis == BOOT_CHASSIS {
            tracing::error!("the boot is gone: stopping");
            self.stop_all(cx).await;
            cx.chassis().exit(EXIT_ORPHAN);
        }
        Ok(())
    }

    /// Creates this chassis's tasks, in the order of the configuration, those that have moved here after them, and registers their names.
    async fn create(&mut self, cx: &Context) -> Result<Created, HandlerError> {
        let chassis = cx.chassis().clone();
        let mut failed: Vec<_> = chassis
            .realtime()
            .iter()
            .filter_map(|grant| Some((format!("processor {}", grant.processor), grant.fatal()?)))
            .collect();
        // None before the first move; asked because this chassis may be one that was started again.
        let moved = cx.call(&Context::server(), MovedTasks {}).await?;
        let moved: BTreeMap<String, Place> = moved.into_iter().collect();
        let own = chassis.app.tasks_on(chassis.name());
        let come = moved.keys().filter_map(|name| chassis.app.task(name));
        let come = come.filter(|config| config.chassis != chassis.name());
        let here = own.chain(come);
        for config in here.filter_map(|config| placed_here(&chassis, config, &moved)) {
            if let Err(reason) = self.create_and_register(cx, &config).await {
                failed.push((config.name, reason));
            }
        }
        Ok(Created {
            tasks: self.tasks.clone(),
            failed,
        })
    }

    async fn create_and_register(
        &mut self,
        cx: &Context,
        config: &TaskConfig,
    ) -> Result<(), String> {
        let tid = create_one(cx, cx.chassis(), config).await?;
        let task = TaskRef::new(config.name.as_str(), tid);
        // It runs, so it is stopped with the others even if its name cannot be had.
        self.tasks.push(task.clone());
        let registered = cx.call(&Context::server(), RegisterTid { task }).await;
        registered.map_err(|error| error.reason())
    }

    /// A place that a task comes to or has left is settled.
    #[command]
    fn settle(&mut self, cx: &Context, Settle { place, how }: Settle) {
        match how {
            Settled::Go { gone } => {
                let Some(record) = cx.chassis().task(place) else {
                    return;
                };
                for chassis in gone {
                    record.mailbox.open_gate(chassis);
                }
                // Nobody here has heard of the chassis that went while the place was made ready. Of those that go
                // from now on this one must hear, as the place awaits the fence of each.
                let chassis = cx.chassis();
                for other in chassis.others().filter(|other| !chassis.reach(*other)) {
                    record.mailbox.forget_gate(other);
                }
                self.arrivals.settle(place, true);
                let task = TaskRef::new(record.name.clone(), place);
                self.tasks.push(task);
            }
            Settled::Drop => {
                self.arrivals.settle(place, false);
            }
            Settled::Retire => {
                cx.chassis().remove_task(place);
                self.tasks.retain(|task| task.tid() != place);
            }
        }
    }

    /// Stops the tasks of this chassis when nobody else is left to order it.
    async fn stop_all(&self, cx: &Context) {
        let timeout = cx.app().stop_timeout;
        for task in self.tasks.iter().rev() {
            let here = cx.chassis();
            if here.directory.current(task.tid()).chassis() != here.index() {
                continue;
            }
            let order = StopTask {
                reason: StopReason::ChassisDown {
                    chassis: BOOT_CHASSIS.to_owned(),
                },
                on: Some(here.index()),
            };
            let stopped = cx.call(task, order).deadline(timeout);
            if let Err(error) = stopped.await
                && !error.is_gone()
            {
                tracing::warn!(task = %task.name(), error = %error, "did not stop");
            }
        }
    }
}

/// The configuration of a task that belongs to this chassis, with the place to which it was moved last.
fn placed_here(
    chassis: &Chassis,
    config: &TaskConfig,
    moved: &BTreeMap<String, Place>,
) -> Option<TaskConfig> {
    let Some(place) = moved.get(&config.name) else {
        return (config.chassis == chassis.name()).then(|| config.clone());
    };
    let (name, _) = chassis.processors.get(usize::from(place.processor))?;
    (place.chassis == chassis.index()).then(|| TaskConfig {
        chassis: chassis.name().to_owned(),
        processor: name.clone(),
        ..config.clone()
    })
}

/// Builds one task on its processor's thread.
async fn create_one(
    cx: &Context,
    chassis: &Arc<Chassis>,
    config: &TaskConfig,
) -> Result<Tid, String> {
    let registry = chassis.registry();
    let kind = registry
        .kind(&config.handler)
        .ok_or_else(|| format!("nobody registered the event handler `{}`", config.handler))?;
    let mut processors = (0..=u8::MAX).zip(&chassis.processors).skip(1);
    let (number, (_, processor)) = processors
        .find(|(_, (name, _))| *name == config.processor)
        .ok_or_else(|| format!("there is no processor `{}`", config.processor))?;
    let slot = chassis.directory.free_slot(number);
    let slot = slot.ok_or("there are too many tasks")?;
    let tid = Tid::new(chassis.index(), number, slot);
    let recipe = kind.recipe_of(config, &chassis.app, &registry);
    let name = &config.name;
    let spec = TaskSpec::new(name, tid, Some(config.clone()), recipe, processor);
    let (built, building) = oneshot::channel();
    let home = chassis.clone();
    processor.inject(move |processor| {
        // Nobody listens any more when the processor was busy for too long.
        let _ = built.send(start_task(&home, processor, spec).map_err(|error| error.to_string()));
    });
    let timeout = cx.app().phase_timeout.max(Duration::from_millis(1));
    match cx.timeout(timeout, building).await {
        Ok(Ok(started)) => started.map(|()| tid),
        Ok(Err(_)) => Err("its processor has stopped".to_owned()),
        Err(elapsed) => Err(format!("its processor is busy: {elapsed}")),
    }
}
