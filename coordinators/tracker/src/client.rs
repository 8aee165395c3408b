//! The client: a process of its own that reads what argus sees, tells the place of the ball from it by a PSOM, and tells that druide
//! (SORMA technical report, section 2.2.4).

use std::{
    cell::{Cell, RefCell},
    rc::Rc,
    time::Duration,
};

use ctos::{
    diagnostic::Finding,
    message::{Command, Message},
    registry::Registry,
    task::{Context, EventHandler, Handled, HandlerError, Phase, TaskRef},
};
use serde::Deserialize;
use sorma::snapshot::{Place, Reader, Snapshot, WriterState};
use vss::{
    components::Doubt,
    target_map::{Located, Seen, TargetMap},
};

use crate::{
    blob::{AMBIGUOUS, Sighting},
    map::{self, Example},
    wire::{BLOB, BlobRecord, LearnMap, LocateBlob, ReadSights, Sights, TargetSeen},
};

/// The handler's name.
pub const HANDLER: &str = "tracker.client";

/// How often it looks for something new.
const LOOK: Duration = Duration::from_millis(2);

/// How often it looks for a buffer, or a task, that is not there.
const LOOK_AGAIN: Duration = Duration::from_millis(200);

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct ClientArgs {
    /// The task that moves the arm.
    #[serde(default = "druide_task")]
    druide: String,
    /// The file of the map's examples, relative to the configuration's folder; what is learned is kept there.
    map: String,
}

fn druide_task() -> String {
    "druide".to_owned()
}

/// Registers the handler.
pub(crate) fn register(registry: &mut Registry) {
    let commands = [LearnMap::INFO, LocateBlob::INFO, ReadSights::INFO];
    let handler = registry.handler(HANDLER, &commands, |cx| Client::new(cx, cx.args()?));
    handler.checked_args::<ClientArgs>(|args, task, app, findings| {
        let place = |key: &str| task.args.locate(key).unwrap_or_else(|| task.place.clone());
        if app.task(&args.druide).is_none() {
            let names = app.tasks.iter().map(|task| task.name.as_str());
            let text = format!("there is no task `{}`", args.druide);
            let finding = Finding::error("ctos::config::unknown_task", text);
            findings.push(finding.at(place("druide")).suggest(&args.druide, names));
        }
        // A map that is not there yet will be learned; one that is there must be one.
        let Ok(source) = app.read(&args.map) else {
            return;
        };
        if let Err(error) = map::read(source.text()).and_then(|all| map::trained(&all)) {
            let text = format!("`{}` is no map: {error}", args.map);
            let help = "learn it anew with `--set 'task.tracker.args.mode=\"learn\"'`";
            let finding = Finding::error("coordinators::tracker::map", text);
            findings.push(finding.at(place("map")).help(help));
        }
    });
}

/// The event handler.
struct Client {
    args: ClientArgs,
    map: Rc<RefCell<Option<TargetMap>>>,
    sights: Rc<Cell<Sights>>,
}

impl Client {
    fn new(cx: &Context, args: ClientArgs) -> Result<Self, HandlerError> {
        let map = match cx.app().read(&args.map) {
            Ok(source) => {
                let read = map::read(source.text()).and_then(|all| map::trained(&all));
                let text = |error| format!("`{}`: {error}", args.map);
                Some(read.map_err(|error| HandlerError::new(text(error)))?)
            }
            Err(_) => None,
        };
        Ok(Self {
            map: Rc::new(RefCell::new(map)),
            sights: Rc::default(),
            args,
        })
    }

    /// Trains a map of examples, keeps them, and uses it.
    fn learn(&self, cx: &Context, examples: &[Example]) -> Result<(), HandlerError> {
        let trained =
            map::trained(examples).map_err(|error| HandlerError::new(error.to_string()))?;
        let path = cx.path(&self.args.map);
        let table = map::table(examples);
        // A replay writes nothing.
        cx.outside("the file of the map", || {
            std::fs::write(&path, table)
                .map_err(|error| format!("cannot write `{}`: {error}", path.display()))
        })?;
        *self.map.borrow_mut() = Some(trained);
        Ok(())
    }
}

fn located(map: &RefCell<Option<TargetMap>>, seen: &Seen) -> Option<Located> {
    let found = map.borrow_mut().as_mut()?.locate(seen).ok()?;
    found.good.then_some(found)
}

impl EventHandler for Client {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            LearnMap::CODE => {
                let (LearnMap { examples }, reply) = message.open::<LearnMap>()?;
                match self.learn(cx, &examples) {
                    Ok(()) => reply.ok(()),
                    Err(error) => reply.fail(error.to_string()),
                }
            }
            LocateBlob::CODE => {
                let (LocateBlob { seen }, reply) = message.open::<LocateBlob>()?;
                let [u, v, radius, spread] = seen;
                let seen = Seen {
                    u,
                    v,
                    radius,
                    spread,
                };
                let found = located(&self.map, &seen);
                reply.ok(found.map(|found| (found.place.coords.into(), found.error)))
            }
            ReadSights::CODE => {
                let (ReadSights {}, reply) = message.open::<ReadSights>()?;
                reply.ok(self.sights.get())
            }
            _ => cx.default_processing(message),
        }
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let placing = Placing {
                cx: cx.clone(),
                args: self.args.clone(),
                map: Rc::clone(&self.map),
                sights: Rc::clone(&self.sights),
            };
            cx.spawn(async move { placing.place_for_ever().await });
        }
        Ok(())
    }
}

/// The client at work.
struct Placing {
    cx: Context,
    args: ClientArgs,
    map: Rc<RefCell<Option<TargetMap>>>,
    sights: Rc<Cell<Sights>>,
}

impl Placing {
    /// Tells druide the place of each ball that is seen.
    async fn place_for_ever(&self) {
        loop {
            if let Err(error) = self.place_all().await {
                tracing::debug!("begins anew: {error}");
            }
            self.cx.sleep(LOOK_AGAIN).await;
        }
    }

    async fn place_all(&self) -> Result<(), HandlerError> {
        let cx = &self.cx;
        let place = Place::of_app(&cx.app().name)?;
        cx.reads_unrecorded("what argus sees");
        let mut reader = Reader::open(&place, BLOB)?;
        let head = reader.head();
        reader.seek(head);
        let druide: TaskRef = cx.task(&self.args.druide).await?;
        let mut record = Snapshot::default();
        let mut silent = 0_u32;
        loop {
            while reader.next(&mut record)?.is_some() {
                silent = 0;
                let Some(blob) = BlobRecord::from_floats(&record.floats) else {
                    continue;
                };
                if let Some(found) = self.locate(&blob.sighting) {
                    let seen = TargetSeen {
                        stamp_ns: blob.stamp_ns,
                        received_ns: blob.received_ns,
                        relative: found.place.coords.into(),
                    };
                    cx.send(&druide, seen).await?;
                }
            }
            silent += 1;
            // A writer that was killed says nothing.
            if silent.is_multiple_of(200) && !matches!(reader.writer(), WriterState::Writing(_)) {
                return Err("argus has ended".into());
            }
            cx.sleep(LOOK).await;
        }
    }

    /// The place of what was seen, if it is the ball. What it is else is counted.
    fn locate(&self, sighting: &Sighting) -> Option<Located> {
        let mut sights = self.sights.get();
        let mut found = None;
        if sighting.doubts == 0 {
            found = located(&self.map, &sighting.seen);
            match found {
                Some(_) => sights.placed += 1,
                None => sights.unknown += 1,
            }
        }
        let kinds = [
            (&mut sights.clipped, &[Doubt::Clipped][..]),
            (&mut sights.size, &[Doubt::Small, Doubt::Large]),
            (
                &mut sights.shape,
                &[Doubt::Elongated, Doubt::Ragged, Doubt::Holes],
            ),
        ];
        for (count, doubts) in kinds {
            *count += u64::from(sighting.has(doubts));
        }
        sights.ambiguous += u64::from(sighting.doubts & AMBIGUOUS != 0);
        self.sights.set(sights);
        found
    }
}
