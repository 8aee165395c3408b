//! The task: follows what all tasks of the app show, records what viewers are told, and tells those that are connected.

use std::{
    cell::{Cell, RefCell},
    net::SocketAddr,
    rc::Rc,
};

use cli_common::page::{self, Front, Kind, Served, Setting};
use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings},
    message::Message,
    task::{Context, EventHandler, Handled, HandlerError, Phase, StopReason},
};
use scene::{
    Batch,
    follow::{Follower, RETRY, sources},
    track::{SceneStep, SceneTrack, Shown},
};
use serde::Deserialize;
use tokio::sync::mpsc::{Receiver, channel};

use crate::{
    live::Live,
    translate::{Sent, Translator},
};

/// `[task.NAME.args]` of the task.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Args {
    /// Where viewers connect; port 0 takes any that is free. Without it everything is only recorded.
    listen: Option<SocketAddr>,
    /// What a viewer must show that comes from elsewhere, or is a page of another site; drawn at random when it is left out.
    token: Option<String>,
    /// What else than its own name and its addresses viewers may call this host.
    #[serde(default)]
    names: Vec<String>,
    /// The app's file of displays, relative to the configuration's folder: each record keeps it as it is.
    displays: Option<String>,
}

/// The channel of a record that keeps the app's file of displays.
pub const DISPLAYS: &str = "/displays";

/// What is kept of it.
#[derive(Debug, Clone, serde::Serialize)]
struct Displays {
    file: String,
    text: String,
}

/// Checks the arguments: whoever else can look on must have keys.
pub(crate) fn check(args: &Args, task: &TaskConfig, app: &App, findings: &mut Findings) {
    if let Some(Err(finding)) = args.displays.as_ref().map(|file| app.read(file)) {
        findings.push(page::at(task, "displays", finding));
    }
    if let Some(listen) = args.listen {
        page::check(task, listen, app, "scene::viewers::open", findings);
    }
}

/// What all parts of the task share.
struct Told {
    translator: RefCell<Translator>,
    live: RefCell<Option<Live>>,
    displays: Option<Displays>,
    /// How many records there were when the displays were written.
    kept: Cell<u64>,
}

impl Told {
    fn send(&self, cx: &Context, all: &[Sent]) {
        for sent in all {
            cx.record_encoded(&sent.channel, &sent.schema, &sent.bytes);
        }
        self.show(all);
    }

    /// Tells those that are connected, and no record.
    fn show(&self, all: &[Sent]) {
        if let Some(live) = &*self.live.borrow() {
            all.iter().for_each(|sent| live.send(sent));
        }
    }

    /// Each record has the displays once.
    fn keep_displays(&self, cx: &Context) {
        let records = cx.recorders();
        if let Some(displays) = &self.displays
            && self.kept.replace(records) != records
        {
            cx.record(DISPLAYS, displays);
        }
    }

    /// All that is known of `source`.
    fn whole(&self, source: &str) -> Vec<Sent> {
        let whole = self.translator.borrow().whole(source);
        whole.unwrap_or_else(|error| {
            tracing::warn!(source, %error, "viewers are told nothing of it");
            Vec::new()
        })
    }
}

/// The event handler.
pub(crate) struct Viewers {
    args: Args,
    told: Rc<Told>,
}

impl Viewers {
    pub(crate) fn new(cx: &Context) -> Result<Self, HandlerError> {
        let args: Args = cx.args()?;
        let displays = args.displays.clone();
        let displays = displays.map(|file| {
            let text = cx.app().read(&file)?.text().to_owned();
            Ok::<_, Finding>(Displays { file, text })
        });
        Ok(Self {
            args,
            told: Rc::new(Told {
                translator: RefCell::default(),
                live: RefCell::default(),
                displays: displays.transpose()?,
                kept: Cell::default(),
            }),
        })
    }

    /// Serves viewers, and tells the whole to those that come.
    fn open(&self, cx: &Context, listen: SocketAddr) -> Handled {
        let (comers, comes) = channel(1);
        let setting = Setting {
            listen,
            names: &self.args.names,
            allow_control: false,
            token: self.args.token.as_deref(),
            kind: Kind::Stream,
        };
        let live = Live::open(cx, Front::bind(cx.app(), &setting)?, comers)?;
        let Served { url, opener, .. } = live.served();
        tracing::info!(
            target: page::LOG_TARGET,
            task = cx.name(),
            address = url,
            open = opener.as_ref().map(tracing::field::display),
            "viewers may connect"
        );
        self.told.live.replace(Some(live));
        let (child, told) = (cx.clone(), Rc::clone(&self.told));
        cx.spawn(async move { greet(&child, &told, comes).await });
        Ok(())
    }
}

impl EventHandler for Viewers {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        let real = cx.chassis().clock().origin_ns().is_some();
        match (phase, self.args.listen) {
            // In virtual time nobody can look on.
            (Phase::Create, Some(listen)) if real => {
                self.open(cx, listen)?;
            }
            (Phase::Connect, _) => {
                for source in sources(cx.app(), &cx.registry()) {
                    let (child, told) = (cx.clone(), Rc::clone(&self.told));
                    cx.spawn(async move { follow(&child, &source, &told).await });
                }
            }
            _ => {}
        }
        Ok(())
    }

    async fn stop(&mut self, _cx: &Context, _reason: &StopReason) -> Handled {
        if let Some(live) = self.told.live.take() {
            live.close();
        }
        Ok(())
    }
}

/// Who comes is told the whole. A record has it already, and does not grow because somebody looks on.
async fn greet(cx: &Context, told: &Told, mut comes: Receiver<()>) {
    while comes.recv().await.is_some() {
        for source in sources(cx.app(), &cx.registry()) {
            told.show(&told.whole(&source));
        }
    }
}

/// Follows one task for good, through the end and the return of its chassis.
async fn follow(cx: &Context, source: &str, told: &Told) {
    let mut follower = Follower::new(cx, source);
    let (mut recorders, mut track) = (0, SceneTrack::default());
    loop {
        let batch = match follower.next().await {
            Ok(batch) => batch,
            Err(error) => {
                tracing::debug!(source, %error, "nothing is shown");
                cx.sleep(RETRY).await;
                continue;
            }
        };
        // Each record begins with the whole.
        let begun = std::mem::replace(&mut recorders, cx.recorders()) != cx.recorders();
        told.keep_displays(cx);
        note(cx, source, &mut track, &batch, begun);
        if begun {
            told.send(cx, &told.whole(source));
        }
        let all = told.translator.borrow_mut().take(source, batch);
        match all {
            Ok(all) => told.send(cx, &all),
            Err(error) => {
                tracing::warn!(source, %error, "viewers miss this; they are told the rest anew");
                told.send(cx, &told.whole(source));
            }
        }
    }
}

/// Records what `ctos display` reads from a record.
fn note(cx: &Context, source: &str, track: &mut SceneTrack, batch: &Batch, begun: bool) {
    let channel = format!("/scene/{source}");
    let step = track.take(SceneStep::new(batch), 0);
    match step {
        _ if begun => cx.record(&channel, track.head()),
        Some(step) => cx.record(&channel, &step),
        None => {}
    }
    if !cx.is_recording() {
        return;
    }
    for picture in &batch.pictures {
        match Shown::new(picture.clone()) {
            Ok(shown) => cx.record(&format!("/picture/{}", shown.camera), &shown),
            // The translation tells why.
            Err(error) => tracing::debug!(source, %error, "a picture is not recorded"),
        }
    }
}
