//! The Vision Services Manager (VSM): the one access point of VSS. It routes each request to its Service and
//! initializes the Vision Modules that the app loaded (CIRSSE report 108, section 5).

use std::collections::BTreeMap;

use ctos::{
    config::TaskConfig,
    message::{Command, CommandInfo, Message},
    task::{Context, EventHandler, Handled, HandlerError, Phase},
};
use serde::Deserialize;

use crate::{
    command::{Calibrate, DiskOffset, FindPair, FindTarget, InitializeVm, SpotFind, VisionError},
    concurrent::answer,
    service::ask,
};

/// The commands it takes.
pub const COMMANDS: &[CommandInfo] = &[
    SpotFind::INFO,
    Calibrate::INFO,
    FindPair::INFO,
    FindTarget::INFO,
    DiskOffset::INFO,
];

/// Its arguments; the catalog writes them.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct VsmArgs {
    /// Command name to the task of its Service.
    routes: BTreeMap<String, String>,
    /// Tasks of the Vision Modules to initialize.
    #[serde(default)]
    vms: Vec<String>,
}

/// The Services Manager.
#[derive(Debug)]
pub struct ServicesManager {
    args: VsmArgs,
}

impl ServicesManager {
    pub(crate) fn new(cx: &Context) -> Result<Self, HandlerError> {
        Ok(Self { args: cx.args()? })
    }

    /// Passes a request on to the Service that the app loaded for it. The reply goes to the asking task; `lost`
    /// makes one of what keeps the Service from replying.
    fn route<C: Command>(
        &self,
        cx: &Context,
        message: Message,
        lost: fn(VisionError) -> Result<C::Reply, HandlerError>,
    ) -> Handled {
        let service = self.args.routes.get(C::NAME).cloned();
        answer::<C, _, _>(cx, message, move |cx, request| async move {
            let Some(service) = service else {
                return Err(HandlerError::new(format!(
                    "this app has not loaded the Service for `{}`; add it to `services` in [vss]",
                    C::NAME
                )));
            };
            ask(&cx, &service, request).await.or_else(lost)
        })
    }
}

/// The Vision Modules, which it initializes while the app is connected.
pub(crate) fn waits_for(task: &TaskConfig) -> Vec<String> {
    let args = task.args.parse::<VsmArgs>();
    args.map_or_else(|_| Vec::new(), |args| args.vms)
}

impl EventHandler for ServicesManager {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            SpotFind::CODE => self.route::<SpotFind>(cx, message, |error| Ok(Err(error))),
            FindPair::CODE => self.route::<FindPair>(cx, message, |error| Ok(Err(error))),
            FindTarget::CODE => self.route::<FindTarget>(cx, message, |error| Ok(Err(error))),
            DiskOffset::CODE => self.route::<DiskOffset>(cx, message, |error| Ok(Err(error))),
            Calibrate::CODE => self.route::<Calibrate>(cx, message, |error| Err(error.into())),
            _ => cx.default_processing(message),
        }
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Connect {
            for vm in &self.args.vms {
                let task = cx.task(vm).await?;
                cx.call(&task, InitializeVm {}).await?;
            }
            for service in self.args.routes.values() {
                cx.task(service).await?;
            }
        }
        Ok(())
    }
}
