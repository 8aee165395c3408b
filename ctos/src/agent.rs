//! The agent: the task of each chassis that creates the configured tasks, and ends the process.

use std::{sync::Arc, time::Duration};

use crate::{
    call::{Fault, Promise, Waiting},
    chassis::{BOOT_CHASSIS, Chassis},
    config::TaskConfig,
    context::{Context, TaskRef},
    message::{Command, CommandInfo, Data, Message, Tid},
    runner::{TaskSpec, record, start_task},
    survey::{Survey, survey},
    system::{
        self, AnnounceUp, ChassisUp, CreateTasks, Created, Exit, RegisterTid, StopTask, TaskName,
    },
    task::{EventHandler, Handled, HandlerError, StopReason},
};

/// What an agent takes.
pub(crate) const COMMANDS: [CommandInfo; 4] = [
    CreateTasks::INFO,
    Exit::INFO,
    Survey::INFO,
    AnnounceUp::INFO,
];

/// Exit code of a chassis whose boot is gone.
const EXIT_ORPHAN: i32 = 5;

/// The agent's state.
#[derive(Default)]
pub(crate) struct Agent {
    tasks: Vec<TaskName>,
}

impl EventHandler for Agent {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            CreateTasks::CODE => {
                let (CreateTasks { first_slots }, reply) = message.open::<CreateTasks>()?;
                let created = self.create(cx, first_slots).await?;
                reply.ok(created)
            }
            Exit::CODE => {
                let (Exit { code }, reply) = message.open::<Exit>()?;
                reply.ok(())?;
                cx.chassis().exit(code);
                Ok(())
            }
            Survey::CODE => {
                let (Survey {}, reply) = message.open::<Survey>()?;
                reply.ok(survey(cx.chassis()))
            }
            AnnounceUp::CODE => {
                let (AnnounceUp { chassis }, _) = message.open::<AnnounceUp>()?;
                for task in cx.chassis().tasks() {
                    let chassis = chassis.clone();
                    cx.chassis().post_system(task.tid, ChassisUp { chassis });
                }
                Ok(())
            }
            _ => cx.default_processing(message),
        }
    }

    async fn chassis_down(&mut self, cx: &Context, chassis: &str) -> Handled {
        if chassis == BOOT_CHASSIS {
            tracing::error!("the boot is gone: stopping");
            self.stop_all(cx).await;
            cx.chassis().exit(EXIT_ORPHAN);
        }
        Ok(())
    }
}

impl Agent {
    /// Creates this chassis's tasks, in the order of the configuration, and registers their names.
    async fn create(&mut self, cx: &Context, mut slots: Vec<u16>) -> Result<Created, HandlerError> {
        let chassis = cx.chassis().clone();
        let mut failed: Vec<_> = chassis
            .realtime()
            .iter()
            .filter_map(|grant| Some((format!("processor {}", grant.processor), grant.fatal()?)))
            .collect();
        slots.resize(chassis.processors.len(), 0);
        let server = TaskRef::new("tidsvr", system::TID_SERVER);
        for config in chassis.app.tasks.iter() {
            if config.chassis != chassis.name() {
                continue;
            }
            match create_one(cx, &chassis, config, &mut slots).await {
                Ok(tid) => {
                    let task = TaskName {
                        name: config.name.clone(),
                        tid,
                    };
                    // It runs, so it is stopped with the others even if its name cannot be had.
                    self.tasks.push(task.clone());
                    if let Err(error) = cx.call(&server, RegisterTid { task }).await {
                        failed.push((config.name.clone(), error.reason()));
                    }
                }
                Err(reason) => failed.push((config.name.clone(), reason)),
            }
        }
        Ok(Created {
            tasks: self.tasks.clone(),
            failed,
        })
    }

    /// Stops the tasks of this chassis when nobody else is left to order it.
    async fn stop_all(&self, cx: &Context) {
        let limit = cx.app().stop_timeout;
        for task in self.tasks.iter().rev() {
            let reference = TaskRef::new(task.name.as_str(), task.tid);
            let reason = StopReason::ChassisDown {
                chassis: BOOT_CHASSIS.to_owned(),
            };
            let stopped = cx.call(&reference, StopTask { reason }).deadline(limit);
            if let Err(error) = stopped.await {
                tracing::warn!(task = %task.name, error = %error, "did not stop");
            }
        }
    }
}

/// Builds one task on its processor's thread.
async fn create_one(
    cx: &Context,
    chassis: &Arc<Chassis>,
    config: &TaskConfig,
    slots: &mut [u16],
) -> Result<Tid, String> {
    let kind = chassis
        .registry
        .kind(&config.handler)
        .ok_or_else(|| format!("nobody registered the event handler `{}`", config.handler))?;
    let (index, processor) = chassis
        .processors
        .iter()
        .enumerate()
        .skip(1)
        .find(|(_, (name, _))| *name == config.processor)
        .map(|(index, (_, handle))| (index, handle.clone()))
        .ok_or_else(|| format!("there is no processor `{}`", config.processor))?;
    let (Ok(number), Some(slot)) = (u8::try_from(index), slots.get_mut(index)) else {
        return Err("there are too many processors".to_owned());
    };
    let tid = Tid::new(chassis.index(), number, *slot);
    *slot = slot.checked_add(1).ok_or("there are too many tasks")?;
    let spec = TaskSpec {
        record: record(&config.name, tid, Some(config)),
        config: Some(config.clone()),
        commands: kind.commands().to_vec(),
        build: kind.builder(),
    };
    let built = Arc::new(Promise::default());
    let answer = built.clone();
    let home = chassis.clone();
    processor.inject(move |processor| {
        let result = start_task(&home, processor, spec);
        answer.fulfil(
            result
                .map(|()| Data::Bytes(Vec::new()))
                .map_err(|error| Fault::Refused {
                    text: error.to_string(),
                }),
        );
    });
    let limit = cx.app().phase_timeout.max(Duration::from_millis(1));
    match cx.timeout(limit, Waiting::here(built)).await {
        Ok(Ok(_)) => Ok(tid),
        Ok(Err(Fault::Refused { text })) => Err(text),
        Ok(Err(_)) => Err("its processor has stopped".to_owned()),
        Err(elapsed) => Err(format!("its processor is busy: {elapsed}")),
    }
}
