//! The nets of a recorded run: what their streams put into the records of an app (`/net/NET` and
//! `/firing/NET`), read back as streams.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    sync::Arc,
};

use cli_common::records;
use ctos::{
    diagnostic::{Findings, Source},
    record::{Filter, ReadError, scan_only},
};
use pnt::stream::{Batch, Event, Mark, NetView, Replica, State};
use scene::track::{SceneStep, Shown};
use serde::Deserialize;

use super::{
    handled::{Ended, Handled, Said},
    hub::Hub,
    overview::Overviews,
    wire::Standing,
};

/// The nets of a run.
#[derive(Debug, Default)]
pub(crate) struct Recorded {
    /// The app's name.
    pub(crate) app: String,
    /// The nets, by name.
    pub(crate) nets: BTreeMap<String, RecordedNet>,
    /// What tasks showed of the scene, by task, and the pictures of cameras: what a display of the run followed.
    scenes: BTreeMap<String, Vec<SceneStep>>,
    pictures: Vec<Shown>,
    /// What tasks handled, and what the log says of them.
    handled: Handled,
    /// The app's file of displays as it was when the run was recorded.
    displays: Option<Kept>,
    /// What a person should know of the records.
    pub(crate) warnings: Vec<String>,
}

/// A net of a run.
#[derive(Debug)]
pub(crate) struct RecordedNet {
    pub(crate) view: NetView,
    pub(crate) steps: Vec<Step>,
}

/// What is known of a net, in order.
#[derive(Debug, Clone)]
pub(crate) enum Step {
    /// It is as this, after so many events that are not known.
    State(Box<State>, u64),
    Event(Box<Event>),
}

/// A file that a record keeps.
#[derive(Debug, Deserialize)]
struct Kept {
    file: String,
    text: String,
}

#[derive(Deserialize)]
struct Whole {
    view: NetView,
    state: State,
}

impl Recorded {
    /// Reads the records of a run, one file for each process.
    ///
    /// # Errors
    /// Files are of several runs, or one cannot be read at all. One that breaks off is read as far as it goes, and told.
    pub(crate) fn read(paths: &[PathBuf]) -> Result<Self, String> {
        let mut recorded = Self::default();
        for path in records::of_a_run(paths)? {
            recorded.file(&path).map_err(|error| error.to_string())?;
        }
        if recorded.is_empty() {
            let text = "no net and no scene stands in these records: they are of an app without both, or of an older version";
            recorded.warnings.push(text.to_owned());
        }
        Ok(recorded)
    }

    /// Leaves every other picture of each camera out, from its last one back, until all of them take at most `most` bytes or
    /// each camera has one; how many were left out.
    pub(crate) fn thin(&mut self, most: usize) -> usize {
        let before = self.pictures.len();
        loop {
            let bytes: usize = self.pictures.iter().map(|one| one.png.len()).sum();
            let mut later: BTreeMap<String, usize> = BTreeMap::new();
            if bytes <= most {
                break;
            }
            let length = self.pictures.len();
            let mut kept = Vec::with_capacity(length);
            for picture in self.pictures.drain(..).rev() {
                let count = later.entry(picture.camera.clone()).or_default();
                if count.is_multiple_of(2) {
                    kept.push(picture);
                }
                *count += 1;
            }
            kept.reverse();
            self.pictures = kept;
            if self.pictures.len() == length {
                break;
            }
        }
        before - self.pictures.len()
    }

    /// Whether there is nothing to show.
    pub(crate) fn is_empty(&self) -> bool {
        self.nets.is_empty() && self.scenes.is_empty() && self.pictures.is_empty()
    }

    fn file(&mut self, path: &Path) -> Result<(), ReadError> {
        let mut odd = 0_u64;
        let shown = Filter {
            topics: [
                "/net/*",
                "/firing/*",
                "/scene/*",
                "/picture/*",
                "/ended/*",
                "/log/*",
                "/displays",
            ]
            .map(str::to_owned)
            .to_vec(),
            ..Filter::default()
        };
        let run = scan_only(path, &shown, |entry| {
            let topic = &entry.channel.topic;
            let taken = if topic.starts_with("/net/") {
                serde_json::from_slice(&entry.json).map(|whole| self.whole(whole))
            } else if topic.starts_with("/firing/") {
                serde_json::from_slice(&entry.json).map(|event| self.event(event))
            } else if let Some(source) = topic.strip_prefix("/scene/") {
                serde_json::from_slice(&entry.json).map(|step| self.step(source, step))
            } else if topic.starts_with("/picture/") {
                serde_json::from_slice(&entry.json).map(|picture| self.pictures.push(picture))
            } else if topic.starts_with("/ended/") {
                serde_json::from_slice::<Ended>(&entry.json)
                    .map(|ended| self.handled.take(entry.at, ended))
            } else if topic == "/displays" {
                serde_json::from_slice(&entry.json).map(|kept| self.displays = Some(kept))
            } else if topic.starts_with("/log/") {
                serde_json::from_slice::<Said>(&entry.json)
                    .map(|said| self.handled.note(entry.at, said))
            } else {
                return;
            };
            odd += u64::from(taken.is_err());
        })?;
        if let Some(app) = run.noted.get("app") {
            self.app.clone_from(app);
        }
        let name = path.display();
        if let Some(torn) = &run.torn {
            let text = format!("{name} breaks off: {torn}; what is before that is shown");
            self.warnings.push(text);
        }
        if odd > 0 {
            let text = format!("{name} has {odd} lines of another version");
            self.warnings.push(text);
        }
        Ok(())
    }

    fn whole(&mut self, whole: Whole) {
        let Whole { view, state } = whole;
        let known = self.nets.get_mut(&view.name);
        match known.filter(|net| net.view == view) {
            Some(net) => {
                let seq = net.seq();
                // The event that the state already knows follows it in the record.
                if state.seq != seq && state.seq != seq + 1 {
                    let skipped = state.seq.saturating_sub(seq);
                    net.steps.push(Step::State(Box::new(state), skipped));
                }
            }
            None => {
                let net = RecordedNet {
                    steps: vec![Step::State(Box::new(state), 0)],
                    view,
                };
                self.nets.insert(net.view.name.clone(), net);
            }
        }
    }

    fn event(&mut self, event: Event) {
        // Before its net as a whole nothing can be shown; after a gap neither, until that comes again.
        if let Some(net) = self.nets.get_mut(&event.net)
            && event.seq == net.seq() + 1
        {
            net.steps.push(Step::Event(Box::new(event)));
        }
    }

    fn step(&mut self, source: &str, step: SceneStep) {
        let steps = self.scenes.entry(source.to_owned()).or_default();
        steps.push(step);
    }

    /// The displays and layouts that the record keeps; what is wrong in them is left out and told.
    pub(crate) fn overviews(&self) -> (Overviews, Findings) {
        let mut findings = Findings::new();
        let read = self.displays.as_ref().map(|Kept { file, text }| {
            let source = Source::new(format!("{file} of the record"), text.clone());
            Overviews::read(&source, &mut findings)
        });
        (read.unwrap_or_default(), findings)
    }

    /// The nets and the scene as a display shows them.
    pub(crate) fn hub(&self, overviews: Overviews) -> Hub {
        let hub = Hub::recorded(&self.app, overviews);
        for net in self.nets.values() {
            let mut steps = net.steps.iter();
            let Some(Step::State(first, _)) = steps.next() else {
                continue;
            };
            // What was read follows from itself: no step is refused.
            let _ = hub.describe(net.view.clone(), (**first).clone());
            for step in steps {
                let _ = hub.take(&net.view.name, batch(step));
            }
        }
        for (source, steps) in &self.scenes {
            for step in steps {
                hub.showed(source, step.clone());
            }
        }
        for picture in &self.pictures {
            hub.pictured(picture.clone());
        }
        hub.stands(Standing {
            chassis: Vec::new(),
            warnings: self.handled.warnings(),
        });
        hub.tasks(self.handled.by(self.nets.values().map(|net| &net.view)));
        hub
    }
}

fn batch(step: &Step) -> Batch {
    let (state, skipped, events, seq) = match step {
        Step::State(state, skipped) => (Some((**state).clone()), *skipped, Vec::new(), state.seq),
        Step::Event(event) => (None, 0, vec![(**event).clone()], event.seq),
    };
    Batch {
        mark: Mark { run: 0, seq },
        state,
        skipped,
        events: Arc::new(events),
    }
}

impl RecordedNet {
    fn seq(&self) -> u64 {
        match self.steps.last() {
            Some(Step::State(state, _)) => state.seq,
            Some(Step::Event(event)) => event.seq,
            None => 0,
        }
    }

    /// The net as it was at `at_ns`, or at the end; and the last events before that. `None` when the record
    /// begins later.
    pub(crate) fn at(&self, at_ns: Option<u64>, events: usize) -> Option<(State, Vec<Event>)> {
        let limit = at_ns.unwrap_or(u64::MAX);
        let mut replica: Option<Replica> = None;
        let mut last = Vec::new();
        for step in &self.steps {
            match (step, &mut replica) {
                (Step::State(state, _), _) if state.at_ns > limit => break,
                (Step::Event(event), _) if event.at_ns > limit => break,
                (Step::State(state, _), replica) => {
                    *replica = Replica::new(&self.view, (**state).clone()).ok();
                }
                (Step::Event(event), Some(replica)) => {
                    // What was read follows from itself.
                    let _ = replica.apply(event);
                    last.push((**event).clone());
                }
                (Step::Event(_), None) => {}
            }
        }
        last.drain(..last.len().saturating_sub(events));
        replica.map(|replica| (replica.state().clone(), last))
    }

    /// When its record begins and ends, ns.
    pub(crate) fn span(&self) -> (u64, u64) {
        let at = |step: Option<&Step>| match step {
            Some(Step::State(state, _)) => state.at_ns,
            Some(Step::Event(event)) => event.at_ns,
            None => 0,
        };
        (at(self.steps.first()), at(self.steps.last()))
    }
}

#[cfg(test)]
mod tests {
    use ctos::diagnostic::Source;
    use pnt::{compile, stream::EventPhase};

    use super::*;

    fn view() -> NetView {
        let text =
            "net n\nplace a = 1, b\ntransition t\n  in a\n  out b\ntransition u\n  in b\n  out a\n";
        let net = compile::net(&Source::new("n.net", text)).unwrap_or_else(|f| panic!("{f}"));
        NetView::new(&net)
    }

    /// The `seq`th event of a token that goes to and fro, one each second.
    fn event(seq: u64) -> Event {
        let (transition, from, to) = if seq % 2 == 1 {
            ("t", "a", "b")
        } else {
            ("u", "b", "a")
        };
        Event {
            seq,
            at_ns: seq * 1_000_000_000,
            net: "n".to_owned(),
            transition: transition.to_owned(),
            phase: EventPhase::Fired,
            text: String::new(),
            firing: None,
            consumed: vec![(from.to_owned(), 1)],
            produced: vec![(to.to_owned(), 1)],
            sent: Vec::new(),
            read: None,
            wrote: None,
            target: String::new(),
            trace: String::new(),
            data: Vec::new(),
        }
    }

    fn state(seq: u64) -> State {
        let places = if seq.is_multiple_of(2) {
            vec![1, 0]
        } else {
            vec![0, 1]
        };
        State {
            seq,
            at_ns: seq * 1_000_000_000,
            places,
            ..State::initial(&view())
        }
    }

    fn whole(seq: u64) -> Whole {
        Whole {
            view: view(),
            state: state(seq),
        }
    }

    #[test]
    fn pictures_are_thinned_evenly_and_the_last_of_each_camera_stays() {
        let picture = |camera: &str, number: u64| Shown {
            camera: camera.to_owned(),
            number,
            at_ns: number,
            taken: [1; 2],
            size: [1; 2],
            png: "x".repeat(100),
            marks: Vec::new(),
            drawing: scene::Drawing::default(),
        };
        let pictures: Vec<Shown> = (1..=16)
            .flat_map(|number| [picture("west", number), picture("east", number)])
            .collect();
        let thinned = |most: usize| {
            let mut recorded = Recorded {
                pictures: pictures.clone(),
                ..Recorded::default()
            };
            let left_out = recorded.thin(most);
            let west = recorded.pictures.iter().filter(|one| one.camera == "west");
            let west: Vec<u64> = west.map(|one| one.number).collect();
            (left_out, west, recorded.pictures.len())
        };
        assert_eq!(thinned(3_200).0, 0);
        assert_eq!(thinned(1_000), (24, vec![4, 8, 12, 16], 8));
        assert_eq!(thinned(1), (30, vec![16], 2));
    }

    #[test]
    fn a_record_with_a_gap_shows_what_is_known_before_and_after_it() {
        let mut recorded = Recorded::default();
        recorded.event(event(1));
        recorded.whole(whole(2));
        for seq in [2, 3, 4, 7, 8] {
            recorded.event(event(seq));
        }
        recorded.whole(whole(9));
        recorded.event(event(9));
        recorded.event(event(10));
        let net = &recorded.nets["n"];
        let places = |seconds: u64| {
            let at = net.at(Some(seconds * 1_000_000_000), 10);
            at.map(|(state, _)| (state.seq, state.places))
        };
        assert_eq!(places(1), None);
        assert_eq!(places(3), Some((3, vec![0, 1])));
        assert_eq!(places(8), Some((4, vec![1, 0])));
        assert_eq!(places(9), Some((9, vec![0, 1])));
        assert_eq!(net.at(None, 2).unwrap().1.len(), 2);
        let skipped = net.steps.iter().filter_map(|step| match step {
            Step::State(_, skipped) => Some(*skipped),
            Step::Event(_) => None,
        });
        assert_eq!(skipped.collect::<Vec<_>>(), [0, 5]);
    }

    #[test]
    fn a_state_in_the_middle_that_fits_interrupts_nothing() {
        let mut recorded = Recorded::default();
        recorded.whole(whole(0));
        recorded.event(event(1));
        recorded.whole(whole(2));
        recorded.event(event(2));
        assert_eq!(recorded.nets["n"].steps.len(), 3);
    }

    #[test]
    fn a_browser_is_told_the_whole_run_at_once_and_nothing_twice() {
        let mut recorded = Recorded::default();
        recorded.whole(whole(0));
        (1..=50).for_each(|seq| recorded.event(event(seq)));
        let hub = recorded.hub(Overviews::default());
        let (told, mut news) = hub.join(false);
        assert_eq!(told.len(), 2);
        let net: serde_json::Value = serde_json::from_str(&told[1]).unwrap();
        assert_eq!(net["kind"], "net");
        assert_eq!(net["entries"].as_array().unwrap().len(), 50);
        assert_eq!(net["base"]["seq"], 0);
        assert!(news.try_recv().is_err());
    }

    #[test]
    fn a_browser_is_told_every_step_of_a_recorded_scene_and_the_first_one_has_all_parts() {
        let mut recorded = Recorded::default();
        let step = |at: u64, x: f64| SceneStep {
            at_ns: at,
            view: (at == 0).then(scene::View::default),
            moved: vec![[0.0, x].map(Some).to_vec()],
            said: None,
        };
        // More than a live display keeps.
        for at in 0..5_000_u32 {
            recorded.step("arm", step(at.into(), at.into()));
        }
        let (told, _) = recorded.hub(Overviews::default()).join(false);
        let scene: serde_json::Value = serde_json::from_str(&told[1]).unwrap();
        assert_eq!(
            (&scene["kind"], &scene["source"]),
            (&"scene".into(), &"arm".into())
        );
        let steps = scene["steps"].as_array().unwrap();
        assert_eq!(steps.len(), 5_000);
        assert!(steps[0]["view"].is_object() && steps[1]["view"].is_null());
        assert_eq!(steps[4_999]["moved"], serde_json::json!([[0.0, 4_999.0]]));
    }

    #[test]
    fn who_comes_while_nothing_happens_is_told_the_present_moment_of_the_app() {
        let clock = ctos::time::Clock::virtual_clock();
        let hub = Hub::live("app", Overviews::default(), clock.clone());
        hub.describe(view(), state(0)).unwrap();
        clock.advance_to(ctos::time::Instant::from_nanos(24_000_000_000));
        let (told, _) = hub.join(true);
        let net: serde_json::Value = serde_json::from_str(&told[1]).unwrap();
        assert_eq!(net["now_ns"], 24_000_000_000_u64);
    }

    #[test]
    fn a_live_display_keeps_a_bounded_past_and_what_it_keeps_leads_to_the_present() {
        let hub = Hub::live(
            "app",
            Overviews::default(),
            ctos::time::Clock::virtual_clock(),
        );
        hub.describe(view(), state(0)).unwrap();
        for seq in 1..=6_001 {
            hub.take("n", batch(&Step::Event(Box::new(event(seq)))))
                .unwrap();
        }
        let (told, _) = hub.join(true);
        let net: serde_json::Value = serde_json::from_str(&told[1]).unwrap();
        let entries = net["entries"].as_array().unwrap();
        assert_eq!(entries.len(), 5_000);
        assert_eq!(net["base"]["seq"], 1_001);
        assert_eq!(net["base"]["places"], serde_json::json!([0, 1]));
        assert_eq!(entries[0]["seq"], 1_002);
        // One that is gone and comes back as it was goes on; what does not fit is refused.
        hub.gone("n", "its chassis is gone");
        hub.describe(view(), state(0)).unwrap();
        assert!(
            hub.take("n", batch(&Step::Event(Box::new(event(7)))))
                .is_err()
        );
    }
}
