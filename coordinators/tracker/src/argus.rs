//! Argus looks: takes pictures with the camera on the wrist, finds the ball in each, and leaves what it sees in a snapshot buffer
//! (SORMA technical report, section 2.2.3).
//!
//! Pictures are taken at an even pace. What one shows is known a while after its exposure; `latency_ms` makes that longer, as a
//! slower host would, and pictures are analysed beside one another then.

use std::{cell::RefCell, rc::Rc, time::Duration};

use ctos::{
    diagnostic::Finding,
    message::{Command, Message},
    registry::Registry,
    task::{Context, EventHandler, Handled, HandlerError, Phase},
};
use rand_distr::{Distribution, StandardNormal};
use serde::Deserialize;
use sorma::snapshot::{Layout, Place, Writer};
use vss::{
    command::{Drawing, Mark, MarkSpot, ShowImage, Snap, VisionError},
    frame::Frame,
    tool::fetched,
};

use crate::{
    blob::{Look, Sighting, largest},
    wire::{BLOB, BlobRecord, ClockTimes, ClockTruth, CompareClocks, TrueClock, TuneLook},
};

/// The handler's name.
pub const HANDLER: &str = "tracker.argus";

/// Records that the buffer keeps.
const SLOTS: usize = 256;

/// Draws beyond so many standard deviations are drawn in: no picture is analysed before it is exposed.
const FURTHEST: f64 = 2.5;

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct ArgusArgs {
    /// The camera.
    camera: String,
    /// The Tool that takes its pictures.
    #[serde(default = "snap")]
    snap: String,
    /// From picture to picture, ms.
    #[serde(default = "period_ms")]
    period_ms: f64,
    /// Mean and standard deviation of the time from an exposure until its result is told, ms.
    #[serde(default)]
    latency_ms: [f64; 2],
    /// What the ball looks like.
    #[serde(default)]
    look: Look,
    /// The Tools that show pictures and mark what is seen in them; every so many pictures one is shown.
    show: Option<ShowArgs>,
}

/// Where pictures are shown.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct ShowArgs {
    /// The Tool that shows a picture.
    #[serde(default = "image_disp")]
    image: String,
    /// The Tool that marks it.
    #[serde(default = "spot_disp")]
    mark: String,
    /// Every so many pictures.
    every: u64,
}

fn snap() -> String {
    "toolSnap".to_owned()
}

fn image_disp() -> String {
    "toolImageDisp".to_owned()
}

fn spot_disp() -> String {
    "toolSpotDisp".to_owned()
}

fn period_ms() -> f64 {
    40.0
}

/// Registers the handler.
pub(crate) fn register(registry: &mut Registry) {
    let commands = [TuneLook::INFO, CompareClocks::INFO, TrueClock::INFO];
    let handler = registry.handler(HANDLER, &commands, |cx| Ok(Argus::new(cx.args()?)));
    handler.checked_args::<ArgusArgs>(|args, task, _, findings| {
        let mut refuse = |key: &str, text: String, help: &str| {
            let place = task.args.locate(key).unwrap_or_else(|| task.place.clone());
            let finding = Finding::error("coordinators::tracker::argus", text);
            findings.push(finding.at(place).help(help));
        };
        if !(args.period_ms >= 1.0 && args.period_ms <= 10_000.0) {
            let text = format!("`period_ms` is {}", args.period_ms);
            refuse("period_ms", text, "give a number from 1 to 10000");
        }
        if !args
            .latency_ms
            .iter()
            .all(|ms| (0.0..=2_000.0).contains(ms))
        {
            let text = format!("`latency_ms` is {:?}", args.latency_ms);
            refuse(
                "latency_ms",
                text,
                "give mean and spread, each from 0 to 2000",
            );
        }
        if args.show.as_ref().is_some_and(|show| show.every == 0) {
            refuse("show", "`show.every` is 0".to_owned(), "give 1 or more");
        }
    });
}

/// The event handler.
struct Argus {
    args: ArgusArgs,
    look: Rc<RefCell<Look>>,
}

impl Argus {
    fn new(args: ArgusArgs) -> Self {
        Self {
            look: Rc::new(RefCell::new(args.look)),
            args,
        }
    }
}

impl EventHandler for Argus {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            TuneLook::CODE => {
                let (TuneLook { look }, reply) = message.open::<TuneLook>()?;
                *self.look.borrow_mut() = look;
                reply.ok(())
            }
            CompareClocks::CODE => {
                let arrived_ns = cx.now().as_nanos();
                let (CompareClocks {}, reply) = message.open::<CompareClocks>()?;
                reply.ok(ClockTimes {
                    arrived_ns,
                    replied_ns: cx.now().as_nanos(),
                })
            }
            TrueClock::CODE => {
                let (TrueClock {}, reply) = message.open::<TrueClock>()?;
                reply.ok(ClockTruth::here(cx))
            }
            _ => cx.default_processing(message),
        }
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase != Phase::Run {
            return Ok(());
        }
        let place = Place::of_app(&cx.app().name)?;
        let layout = Layout::new(SLOTS, BlobRecord::FLOATS).described(BlobRecord::DESCRIPTION);
        let writer = Writer::create(&place, BLOB, layout, cx.chassis().clock())?;
        let looking = Looking {
            cx: cx.clone(),
            args: self.args.clone(),
            look: Rc::clone(&self.look),
            writer: Rc::new(RefCell::new(writer)),
        };
        cx.spawn(async move { looking.look_for_ever().await });
        Ok(())
    }
}

/// Argus at work.
#[derive(Clone)]
struct Looking {
    cx: Context,
    args: ArgusArgs,
    look: Rc<RefCell<Look>>,
    writer: Rc<RefCell<Writer>>,
}

impl Looking {
    async fn look_for_ever(&self) {
        let period = Duration::from_secs_f64(self.args.period_ms * 1e-3);
        let mut rng = self.cx.rng("latency");
        let mut due = self.cx.now();
        let mut failing: Option<String> = None;
        loop {
            let now = self.cx.now();
            if due > now {
                self.cx.sleep(due.since(now)).await;
            } else if now.since(due) > period {
                // Late pictures are left out, not made up for.
                due = now;
            }
            due = due + period;
            match self.take().await {
                Ok(frame) => {
                    if failing.take().is_some() {
                        tracing::info!(camera = self.args.camera, "gives pictures again");
                    }
                    let [mean, spread] = self.args.latency_ms;
                    let draw: f64 = StandardNormal.sample(&mut rng);
                    let late = (mean + spread * draw.clamp(-FURTHEST, FURTHEST)).max(0.0) * 1e-3;
                    let told = frame.stamp + Duration::from_secs_f64(late);
                    let (own, after) = (self.clone(), self.cx.now().since_start());
                    let wait = told.saturating_sub(after);
                    let analysed = self.analyse(frame).await;
                    if wait.is_zero() {
                        own.tell(analysed);
                    } else {
                        let cx = own.cx.clone();
                        cx.spawn(async move {
                            own.cx.sleep(wait).await;
                            own.tell(analysed);
                        });
                    }
                }
                Err(error) => {
                    // What was measured of a picture is another number each time, and no news.
                    let mut kind = error.to_string();
                    kind.retain(char::is_alphabetic);
                    if failing.as_ref() != Some(&kind) {
                        tracing::warn!(camera = self.args.camera, "no picture: {error}");
                        failing = Some(kind);
                    }
                }
            }
        }
    }

    async fn take(&self) -> Result<Frame, HandlerError> {
        let snap = self.cx.task(&self.args.snap).await?;
        let camera = self.args.camera.clone();
        let frame: Result<Frame, VisionError> = self.cx.call(&snap, Snap { camera }).await?;
        let frame = frame.and_then(|frame| fetched(&self.cx, frame));
        frame.map_err(|error| HandlerError::new(error.to_string()))
    }

    /// What a picture shows, if anything.
    async fn analyse(&self, frame: Frame) -> Option<BlobRecord> {
        let look = *self.look.borrow();
        // A camera of another chassis has its own clock: then what counts is when its picture is here.
        let here = self.cx.now().since_start();
        let received = frame.received.unwrap_or(here);
        let found = largest(&frame, &look);
        let (number, stamp) = (frame.number, frame.stamp);
        if let Some(show) = &self.args.show
            && number.is_multiple_of(show.every)
        {
            self.show(show, frame, found.as_ref());
        }
        let ns = |moment: Duration| u64::try_from(moment.as_nanos()).unwrap_or(u64::MAX);
        found.map(|sighting| BlobRecord {
            stamp_ns: ns(stamp),
            received_ns: ns(received),
            number,
            sighting,
        })
    }

    fn tell(&self, found: Option<BlobRecord>) {
        let Some(record) = found else { return };
        if let Err(error) = self.writer.borrow_mut().write(&record.floats(), &[]) {
            tracing::warn!("what was seen is not told: {error}");
        }
    }

    /// Shows a picture with the ball marked in it. A dark screen must cost no measurement, so nobody waits for it.
    fn show(&self, show: &ShowArgs, frame: Frame, found: Option<&Sighting>) {
        let (cx, show) = (self.cx.clone(), show.clone());
        let camera = self.args.camera.clone();
        let mark = found.filter(|found| found.doubts == 0).map(|found| Mark {
            u: found.seen.u,
            v: found.seen.v,
            sd: [0.0; 2],
        });
        self.cx.spawn(async move {
            let shown = async {
                let image = cx.task(&show.image).await?;
                let picture = ShowImage {
                    camera: camera.clone(),
                    frame,
                    drawing: Drawing::default(),
                };
                cx.call(&image, picture).await?;
                if let Some(mark) = mark {
                    let marker = cx.task(&show.mark).await?;
                    cx.call(&marker, MarkSpot { camera, mark }).await?;
                }
                Ok::<(), HandlerError>(())
            };
            if let Err(error) = shown.await {
                tracing::debug!("picture not shown: {error}");
            }
        });
    }
}
