//! What is known of all nets that are shown: their views, a bounded past and the present; and the way by which
//! what is new reaches every browser.

use std::{
    collections::{BTreeMap, VecDeque},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use ctos::{
    diagnostic::{Findings, Severity},
    time::Clock,
};
use pnt::{
    layout::{Detail, Drawing, LayoutFile},
    stream::{Batch, Event, NetView, Replica, ReplicaError, State},
};
use scene::track::{SceneStep, SceneTrack, Shown};
use scene_summary::{Step, Summary};
use tokio::sync::broadcast;

use super::{
    overview::Overviews,
    wire::{Breakpoint, Entry, Load, Note, Overview, Standing, TaskState, Told},
};

/// Events of each net that are kept for browsers that come later.
const KEPT: usize = 5_000;

/// Steps of a live scene that are kept for them: about two minutes of motion.
const KEPT_STEPS: usize = 2_000;

/// Pictures of each camera that are kept for them.
const KEPT_PICTURES: usize = 12;

/// Messages that a browser may be behind before it is told everything anew.
const BEHIND: usize = 512;

/// What happened, in order.
#[derive(Debug, Clone)]
enum Past {
    Event(Event),
    /// The net was as this, after events that are not known.
    State(State, u64),
}

/// One net.
#[derive(Debug)]
pub(crate) struct Track {
    view: NetView,
    written: Drawing,
    full: Drawing,
    /// The net before the past that is kept.
    base: Replica,
    past: VecDeque<Past>,
    head: Replica,
    gone: Option<String>,
    breakpoints: Vec<Breakpoint>,
}

impl Track {
    fn new(view: NetView, state: State) -> Result<Self, ReplicaError> {
        let base = Replica::new(&view, state)?;
        Ok(Self {
            written: Drawing::new(&view, Detail::Written),
            full: Drawing::new(&view, Detail::Full),
            head: base.clone(),
            base,
            view,
            past: VecDeque::new(),
            gone: None,
            breakpoints: Vec::new(),
        })
    }

    fn keep(&mut self, past: Past, most: usize) -> Result<(), ReplicaError> {
        self.past.push_back(past);
        while self.past.len() > most {
            match self.past.pop_front() {
                Some(Past::Event(event)) => self.base.apply(&event)?,
                Some(Past::State(state, _)) => self.base.set(state)?,
                None => break,
            }
        }
        Ok(())
    }

    fn told(&self, notes: &[Note], now_ns: u64) -> String {
        let entries = self.past.iter().map(|past| match past {
            Past::Event(event) => Entry::Event(event),
            Past::State(state, skipped) => Entry::State {
                state,
                skipped: *skipped,
            },
        });
        let own = notes.iter().filter(|note| note.net == self.view.name);
        let own: Vec<Note> = own.cloned().collect();
        Told::Net {
            net: &self.view.name,
            view: &self.view,
            written: &self.written,
            full: &self.full,
            base: self.base.state(),
            entries: entries.collect(),
            gone: self.gone.as_deref(),
            breakpoints: &self.breakpoints,
            notes: &own,
            now_ns,
        }
        .text()
    }
}

#[derive(Debug, Default)]
struct Known {
    tracks: BTreeMap<String, Track>,
    /// What tasks show of the scene, by task.
    scenes: BTreeMap<String, SceneTrack>,
    /// The last pictures, by camera.
    pictures: BTreeMap<String, VecDeque<Shown>>,
    /// What tasks sum up, by task, and why one cannot be asked.
    summaries: BTreeMap<String, (Summary, Option<String>)>,
    notes: Vec<Note>,
    /// The tasks of which more can be told.
    names: Vec<String>,
    /// What a record says of them.
    tasks: Vec<TaskState>,
    standing: Standing,
    now_ns: u64,
    ended: bool,
    overviews: Overviews,
}

impl Known {
    fn displays(&self) -> Vec<Overview> {
        let written = |net: &str| self.tracks.get(net).map(|track| &track.written);
        self.overviews.drawn(written)
    }
}

/// What all browsers share.
#[derive(Debug)]
pub(crate) struct Hub {
    app: String,
    mode: &'static str,
    most: usize,
    /// The app's, while it runs.
    clock: Option<Clock>,
    known: Mutex<Known>,
    news: broadcast::Sender<Arc<str>>,
}

impl Hub {
    /// For the nets of a running app.
    pub(crate) fn live(app: &str, overviews: Overviews, clock: Clock) -> Self {
        Self {
            clock: Some(clock),
            ..Self::new(app, "live", KEPT, overviews)
        }
    }

    /// With the names of the app's tasks; a viewer can ask for more about each.
    pub(crate) fn with_tasks(self, names: Vec<String>) -> Self {
        self.known().names = names;
        self
    }

    /// For the nets of a recorded run, whose past is kept as a whole.
    pub(crate) fn recorded(app: &str, overviews: Overviews) -> Self {
        Self::new(app, "record", usize::MAX, overviews)
    }

    fn new(app: &str, mode: &'static str, most: usize, overviews: Overviews) -> Self {
        Self {
            app: app.to_owned(),
            mode,
            most,
            clock: None,
            known: Mutex::new(Known {
                overviews,
                ..Known::default()
            }),
            news: broadcast::Sender::new(BEHIND),
        }
    }

    /// A panic elsewhere leaves what is known as it was: every change is whole.
    fn known(&self) -> MutexGuard<'_, Known> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn tell(&self, told: &Told) {
        if !self.is_watched() {
            return;
        }
        // The last one may just have gone.
        let _ = self.news.send(told.text().into());
    }

    /// A net is there, for the first time or again. What is known of the same net's past stays.
    ///
    /// # Errors
    /// The state is of another net.
    pub(crate) fn describe(&self, view: NetView, state: State) -> Result<(), ReplicaError> {
        let mut known = self.known();
        known.now_ns = known.now_ns.max(state.at_ns);
        if let Some(track) = known.tracks.get_mut(&view.name)
            && track.view == view
        {
            track.gone = None;
            return self.jump(track, state, 0);
        }
        let track = Track::new(view, state)?;
        if self.is_watched() {
            // There is no viewer, where the last one has just gone.
            let _ = self
                .news
                .send(track.told(&known.notes, known.now_ns).into());
        }
        known.tracks.insert(track.view.name.clone(), track);
        let displays = known.displays();
        if !displays.is_empty() {
            self.tell(&Told::Displays { displays });
        }
        Ok(())
    }

    fn jump(&self, track: &mut Track, state: State, skipped: u64) -> Result<(), ReplicaError> {
        track.head.set(state.clone())?;
        self.tell(&Told::State {
            net: &track.view.name,
            state: &state,
            skipped,
        });
        track.keep(Past::State(state, skipped), self.most)
    }

    /// What a net did.
    ///
    /// # Errors
    /// It does not fit what is known: the net must be described anew.
    pub(crate) fn take(&self, net: &str, batch: Batch) -> Result<(), ReplicaError> {
        let mut known = self.known();
        let Known { tracks, now_ns, .. } = &mut *known;
        let Some(track) = tracks.get_mut(net) else {
            return Ok(());
        };
        if let Some(state) = batch.state {
            *now_ns = (*now_ns).max(state.at_ns);
            self.jump(track, state, batch.skipped)?;
        }
        if batch.events.is_empty() {
            return Ok(());
        }
        for event in batch.events.iter() {
            track.head.apply(event)?;
            track.keep(Past::Event(event.clone()), self.most)?;
            *now_ns = (*now_ns).max(event.at_ns);
        }
        self.tell(&Told::Events {
            net,
            events: &batch.events,
        });
        Ok(())
    }

    /// A net cannot be reached.
    pub(crate) fn gone(&self, net: &str, reason: &str) {
        let mut known = self.known();
        let Some(track) = known.tracks.get_mut(net) else {
            return;
        };
        if track.gone.as_deref() == Some(reason) {
            return;
        }
        track.gone = Some(reason.to_owned());
        self.tell(&Told::Gone { net, reason });
    }

    /// Tasks that will show something.
    pub(crate) fn expects(&self, sources: &[String]) {
        let mut known = self.known();
        for source in sources {
            known.scenes.entry(source.clone()).or_default();
        }
    }

    /// Tasks that will sum up something.
    pub(crate) fn expects_summaries(&self, sources: &[String]) {
        let mut known = self.known();
        for source in sources {
            known.summaries.entry(source.clone()).or_default();
        }
    }

    /// What a task sums up has changed.
    pub(crate) fn summed(&self, source: &str, step: Step) {
        let mut known = self.known();
        let (summary, gone) = known.summaries.entry(source.to_owned()).or_default();
        if gone.take().is_some() || step.is_news() {
            self.tell(&Told::Summary {
                source,
                step: &step,
            });
        }
        summary.take(step);
    }

    /// A task that sums up cannot be asked.
    pub(crate) fn unsummed(&self, source: &str, reason: &str) {
        let mut known = self.known();
        let (_, gone) = known.summaries.entry(source.to_owned()).or_default();
        if gone.as_deref() != Some(reason) {
            *gone = Some(reason.to_owned());
            self.tell(&Told::Unsummed { source, reason });
        }
    }

    /// Whether a net is known.
    pub(crate) fn follows(&self, net: &str) -> bool {
        self.known().tracks.contains_key(net)
    }

    /// A net is not followed any more, and what is known of it is forgotten.
    pub(crate) fn leave(&self, net: &str) {
        if self.known().tracks.remove(net).is_some() {
            self.tell(&Told::Left { net });
        }
    }

    /// What a task shows has changed; what of it is new, if anything is.
    pub(crate) fn showed(&self, source: &str, step: SceneStep) -> Option<SceneStep> {
        let mut known = self.known();
        known.now_ns = known.now_ns.max(step.at_ns);
        let track = known.scenes.entry(source.to_owned()).or_default();
        track.gone = None;
        // A record is shown from its beginning.
        let most = self.clock.as_ref().map_or(usize::MAX, |_| KEPT_STEPS);
        let step = track.take(step, most)?;
        self.tell(&Told::Moved {
            source,
            step: &step,
        });
        Some(step)
    }

    /// What a task shows now, as a whole.
    pub(crate) fn scene(&self, source: &str) -> SceneStep {
        let known = self.known();
        let track = known.scenes.get(source);
        track.map(|track| track.head().clone()).unwrap_or_default()
    }

    /// A camera has a new picture, or the same one with more found in it.
    pub(crate) fn pictured(&self, picture: Shown) {
        self.tell(&Told::Picture { picture: &picture });
        let mut known = self.known();
        let all = known.pictures.entry(picture.camera.clone()).or_default();
        keep(all, picture, self.clock.is_some());
    }

    /// What a task shows cannot be seen.
    pub(crate) fn dark(&self, source: &str, reason: &str) {
        let mut known = self.known();
        let track = known.scenes.entry(source.to_owned()).or_default();
        if track.gone.as_deref() != Some(reason) {
            track.gone = Some(reason.to_owned());
            self.tell(&Told::Dark { source, reason });
        }
    }

    /// The breakpoints of a net, if they have changed.
    pub(crate) fn breakpoints(&self, net: &str, breakpoints: Vec<Breakpoint>) {
        let mut known = self.known();
        let Some(track) = known.tracks.get_mut(net) else {
            return;
        };
        if track.breakpoints != breakpoints {
            track.breakpoints = breakpoints;
            self.tell(&Told::Breakpoints {
                net,
                breakpoints: &track.breakpoints,
            });
        }
    }

    /// A net as it is drawn in its author's words.
    pub(crate) fn written(&self, net: &str) -> Option<Drawing> {
        let known = self.known();
        known.tracks.get(net).map(|track| track.written.clone())
    }

    /// Nodes of a net stand elsewhere.
    pub(crate) fn arranged(&self, net: &str, file: LayoutFile) {
        let mut known = self.known();
        let Some(track) = known.tracks.get_mut(net) else {
            return;
        };
        // What of the file is another net's was told when it was read first.
        file.pin(&mut track.view);
        track.written = Drawing::new(&track.view, Detail::Written);
        track.full = Drawing::new(&track.view, Detail::Full);
        self.tell(&Told::Drawing {
            net,
            written: &track.written,
            full: &track.full,
        });
        let displays = known.displays();
        if !displays.is_empty() {
            self.tell(&Told::Displays { displays });
        }
    }

    /// An overview display as it is drawn.
    pub(crate) fn overview(&self, name: &str) -> Option<Overview> {
        let displays = self.known().displays();
        displays.into_iter().find(|display| display.name == name)
    }

    /// Nodes of overview displays stand elsewhere.
    pub(crate) fn rearranged(&self, arrange: impl FnOnce(&mut Overviews)) {
        let mut known = self.known();
        arrange(&mut known.overviews);
        let displays = known.displays();
        self.tell(&Told::Displays { displays });
        self.tell(&Told::Layouts {
            layouts: known.overviews.layouts(),
        });
    }

    /// What the analysis found, as far as it is about nodes.
    pub(crate) fn notes(&self, findings: &Findings) {
        let mut known = self.known();
        let found = findings.iter().filter_map(|finding| {
            let at = finding.place.as_ref()?.to_string();
            let (net, node) = known.tracks.values().find_map(|track| {
                let node = track.view.node_at(&at)?;
                Some((track.view.name.clone(), node.to_owned()))
            })?;
            Some(Note {
                net,
                node,
                severity: match finding.severity {
                    Severity::Error => "error",
                    Severity::Warning => "warning",
                },
                message: finding.message.clone(),
                at,
            })
        });
        let notes: Vec<Note> = found.collect();
        self.tell(&Told::Notes { notes: &notes });
        known.notes = notes;
    }

    /// What a record says of the tasks that nets call.
    pub(crate) fn tasks(&self, tasks: Vec<TaskState>) {
        let mut known = self.known();
        known.names = tasks.iter().map(|task| task.name.clone()).collect();
        known.tasks = tasks;
    }

    /// Whether somebody looks.
    pub(crate) fn is_watched(&self) -> bool {
        self.news.receiver_count() > 0
    }

    /// How the app stands as a whole.
    pub(crate) fn stands(&self, standing: Standing) {
        let mut known = self.known();
        if known.standing != standing {
            known.standing = standing;
            self.tell(&Told::Standing {
                standing: &known.standing,
            });
        }
    }

    /// How loaded the tasks are. Browsers that come later are not told.
    pub(crate) fn loaded(&self, at_ns: u64, tasks: &[Load]) {
        self.tell(&Told::Load { at_ns, tasks });
    }

    /// The app has ended.
    pub(crate) fn end(&self) {
        self.known().ended = true;
        self.tell(&Told::End {});
    }

    /// Everything that is known, and what will be new.
    pub(crate) fn join(&self, control: bool) -> (Vec<String>, broadcast::Receiver<Arc<str>>) {
        let known = self.known();
        // Under the lock: nothing is missed and nothing comes twice.
        let news = self.news.subscribe();
        let mut told = vec![self.hello(&known, control)];
        let nets = known.tracks.values();
        // It goes on where nets do nothing.
        let clock = self.clock.as_ref().filter(|_| !known.ended);
        let now_ns = clock.map_or(0, |clock| clock.now().as_nanos());
        let now_ns = now_ns.max(known.now_ns);
        let nets = nets.map(|track| track.told(&known.notes, now_ns));
        let scenes = known.scenes.iter().map(|(source, track)| {
            Told::Scene {
                source,
                gone: track.gone.as_deref(),
                steps: track.steps(),
            }
            .text()
        });
        told.extend(scenes);
        for (source, (summary, gone)) in &known.summaries {
            let step = &summary.since(None);
            told.push(Told::Summary { source, step }.text());
            if let Some(reason) = gone {
                told.push(Told::Unsummed { source, reason }.text());
            }
        }
        let pictures = known.pictures.values().flatten();
        told.extend(pictures.map(|picture| Told::Picture { picture }.text()));
        // After the scene, which is seen at once: nets have long pasts.
        told.extend(nets);
        let tasks = known.tasks.iter().cloned();
        told.extend(tasks.map(|task| Told::Task { task }.text()));
        let standing = &known.standing;
        if *standing != Standing::default() {
            told.push(Told::Standing { standing }.text());
        }
        if known.ended {
            told.push(Told::End {}.text());
        }
        (told, news)
    }

    fn hello(&self, known: &Known, control: bool) -> String {
        Told::Hello {
            app: &self.app,
            mode: self.mode,
            control,
            nets: known.tracks.keys().map(String::as_str).collect(),
            tasks: &known.names,
            displays: known.displays(),
            layouts: known.overviews.layouts(),
            handles: known.overviews.handles(),
            plans: known.overviews.plans(),
            scenes: known.scenes.len(),
            summaries: known.summaries.keys().map(String::as_str).collect(),
            origin_ns: self.clock.as_ref().and_then(Clock::origin_ns),
        }
        .text()
    }
}

/// Puts a picture behind those of its camera, in place of the same one with fewer marks.
fn keep(pictures: &mut VecDeque<Shown>, shown: Shown, live: bool) {
    if pictures
        .back()
        .is_some_and(|last| last.number == shown.number)
    {
        pictures.pop_back();
    }
    pictures.push_back(shown);
    while live && pictures.len() > KEPT_PICTURES {
        pictures.pop_front();
    }
}
