//! The source's end of the stream: looks at what a task shows when somebody follows, keeps what has changed when, and answers.
//!
//! It keeps the latest state only, with the number of its last change. So what one follower is told does not depend on the
//! others, and nothing is kept for anybody.

use std::{cell::RefCell, rc::Rc, time::Duration};

use ctos::{
    message::Message,
    task::{Context, Handled},
    time::Instant,
};

use crate::{
    Batch, FollowScene, MOST_FOLLOWERS, MOST_PATIENCE_MS, Mark, Moved, Number, PERIOD, Picture,
    Pose, Said, View,
};

/// A smaller change of a coordinate (m), or of a part of a quaternion, is not told.
const RESOLUTION: f64 = 1e-5;

/// What a task shows at one moment.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Seen {
    /// Each part, in the order of the view.
    pub states: Vec<(Pose, Vec<f64>)>,
    /// What there is to say.
    pub said: Said,
    /// The latest picture of each camera that has a new one or new marks since the last look.
    pub pictures: Vec<Picture>,
}

/// Something to look at.
pub trait Source: 'static {
    /// The parts from now on, if there are others than at the last call.
    fn view(&mut self) -> Option<View>;

    /// What there is to see now.
    fn look(&mut self) -> Seen;
}

struct State {
    source: Box<dyn Source>,
    run: Option<u64>,
    seq: u64,
    looked: Option<Instant>,
    view: (View, u64),
    states: Vec<(Pose, Vec<f64>, u64)>,
    said: (Said, u64),
    pictures: Vec<(Picture, u64)>,
}

/// What a task shows, for those who follow. A clone is the same one.
#[derive(Clone)]
pub struct Stage {
    inner: Rc<RefCell<State>>,
    /// Shared with each follower that waits.
    followers: Rc<()>,
}

impl Stage {
    /// A stage for what `source` shows.
    #[must_use]
    pub fn new(source: impl Source) -> Self {
        let inner = State {
            source: Box::new(source),
            run: None,
            seq: 0,
            looked: None,
            view: (View::default(), 0),
            states: Vec::new(),
            said: (Said::default(), 0),
            pictures: Vec::new(),
        };
        Self {
            inner: Rc::new(RefCell::new(inner)),
            followers: Rc::new(()),
        }
    }

    /// How many wait for something to change.
    #[must_use]
    pub fn followers(&self) -> usize {
        Rc::strong_count(&self.followers) - 1
    }

    /// Answers a [`FollowScene`] when there is something to tell, or when the follower's patience is over.
    ///
    /// # Errors
    /// The message is another one.
    pub fn follow(&self, cx: &Context, message: Message) -> Handled {
        let (request, reply) = message.open::<FollowScene>()?;
        if self.followers() >= MOST_FOLLOWERS {
            let text = format!("{MOST_FOLLOWERS} follow task `{}` already", cx.name());
            return reply.fail(text);
        }
        let patience = request.patience_ms.min(MOST_PATIENCE_MS);
        let until = cx.now() + Duration::from_millis(patience.into());
        let (own, inner) = (cx.clone(), Rc::clone(&self.inner));
        let follower = Rc::clone(&self.followers);
        cx.spawn(async move {
            let batch = loop {
                let wait = inner.borrow().due_in(own.now());
                if !wait.is_zero() {
                    own.sleep(wait).await;
                }
                let now = own.now();
                let batch = inner.borrow_mut().batch(now, request.after);
                if batch.is_news() || now >= until {
                    break batch;
                }
            };
            drop(follower);
            // A viewer that is gone needs no answer.
            let _ = reply.ok(batch);
        });
        Ok(())
    }
}

fn differ(one: &Pose, other: &Pose) -> bool {
    let far = |(a, b): (&f64, &f64)| (a - b).abs() > RESOLUTION;
    one.at.iter().zip(&other.at).any(far) || one.turn.iter().zip(&other.turn).any(far)
}

impl State {
    /// How long nobody may look again.
    fn due_in(&self, now: Instant) -> Duration {
        let passed = self.looked.map(|looked| now.since(looked));
        passed.map_or(Duration::ZERO, |passed| PERIOD.saturating_sub(passed))
    }

    /// What has changed since `after`, as far as it is known now.
    fn batch(&mut self, now: Instant, after: Option<Mark>) -> Batch {
        let run = *self.run.get_or_insert(now.as_nanos());
        if self.due_in(now).is_zero() {
            self.look();
            self.looked = Some(now);
        }
        let since = after.filter(|mark| mark.run == run && mark.seq <= self.seq);
        let is_new = |change: u64| since.is_none_or(|mark| change > mark.seq);
        let whole = is_new(self.view.1);
        let states = self.states.iter().zip(0_u32..);
        let moved = states.filter(|((_, _, change), _)| whole || is_new(*change));
        let pictures = self.pictures.iter().filter(|(_, change)| is_new(*change));
        Batch {
            mark: Mark { run, seq: self.seq },
            at_ns: self.looked.unwrap_or(now).as_nanos(),
            view: whole.then(|| self.view.0.clone()),
            moved: moved
                .map(|((pose, numbers, _), part)| Moved {
                    part,
                    pose: *pose,
                    numbers: numbers.clone(),
                })
                .collect(),
            said: is_new(self.said.1).then(|| self.said.0.clone()),
            pictures: pictures.map(|(picture, _)| picture.clone()).collect(),
        }
    }

    /// Looks at the source; what has changed gets the next number.
    fn look(&mut self) {
        let change = self.seq + 1;
        let mut changed = false;
        if let Some(view) = self.source.view() {
            self.view = (view, change);
            self.states.clear();
            changed = true;
        }
        let Seen {
            states,
            said,
            pictures,
        } = self.source.look();
        if said != self.said.0 {
            self.said = (said, change);
            changed = true;
        }
        for picture in pictures {
            let same = |(known, _): &&mut (Picture, u64)| known.camera == picture.camera;
            match self.pictures.iter_mut().find(same) {
                Some(known) => *known = (picture, change),
                None => self.pictures.push((picture, change)),
            }
            changed = true;
        }
        let first = self.states.is_empty();
        if first {
            changed |= !states.is_empty();
            let known = states.into_iter();
            self.states = known
                .map(|(pose, numbers)| (pose, numbers, change))
                .collect();
        } else {
            let parts = &self.view.0.parts;
            let known = self.states.iter_mut().zip(parts);
            for ((known, part), (pose, numbers)) in known.zip(states) {
                let mut pairs = numbers.iter().zip(&known.1).zip(&part.numbers);
                // A number that is none any more, or is one again, has changed.
                let changes = |((new, old), number): ((&f64, &f64), &Number)| {
                    new.is_nan() != old.is_nan() || (new - old).abs() > number.resolution
                };
                let moved = differ(&pose, &known.0) || pairs.any(changes);
                if moved {
                    *known = (pose, numbers, change);
                    changed = true;
                }
            }
        }
        if changed {
            self.seq = change;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::{
        Arc,
        atomic::{AtomicU32, Ordering},
    };

    use ctos::{
        Command as _,
        boot::End,
        registry::Registry,
        system::AppResult,
        task::{EventHandler, Phase},
    };

    use super::*;
    use crate::{Number, Part};

    /// A ball at `x`, of which a number is told, and what it says.
    struct Ball(Thrown);

    /// Where it is, its weight, and how often its parts were asked for.
    type Thrown = Rc<RefCell<(f64, f64, u32)>>;

    impl Source for Ball {
        fn view(&mut self) -> Option<View> {
            let mut state = self.0.borrow_mut();
            state.2 += 1;
            let part = Part {
                name: "ball".to_owned(),
                numbers: vec![Number {
                    name: "weight".to_owned(),
                    unit: "N".to_owned(),
                    resolution: 0.1,
                }],
                ..Part::default()
            };
            let parts = vec![part.clone(), part];
            let view = View {
                parts,
                ..View::default()
            };
            (state.2 == 1).then_some(view)
        }

        fn look(&mut self) -> Seen {
            let (x, weight, _) = *self.0.borrow();
            let pose = Pose {
                at: [x, 0.0, 0.0],
                ..Pose::default()
            };
            Seen {
                states: vec![(pose, vec![weight]), (Pose::default(), vec![0.0])],
                ..Seen::default()
            }
        }
    }

    fn stage() -> (State, Thrown) {
        let state = Rc::new(RefCell::new((0.0, 0.0, 0)));
        let stage = Stage::new(Ball(Rc::clone(&state)));
        (Rc::into_inner(stage.inner).unwrap().into_inner(), state)
    }

    fn at(ms: u64) -> Instant {
        Instant::from_nanos(ms * 1_000_000)
    }

    #[test]
    fn who_is_new_is_told_everything_and_then_only_what_has_changed() {
        let (mut stage, state) = stage();
        let first = stage.batch(at(0), None);
        assert_eq!(first.view.unwrap().parts.len(), 2);
        assert_eq!(first.moved.len(), 2);
        assert!(!stage.batch(at(60), Some(first.mark)).is_news());
        state.borrow_mut().0 = 0.5;
        let next = stage.batch(at(120), Some(first.mark));
        assert_eq!((next.view, next.moved.len()), (None, 1));
        assert_eq!(next.moved[0].pose.at, [0.5, 0.0, 0.0]);
        assert_eq!(next.at_ns, 120_000_000);
        // One who is behind is told the same, and who comes late everything.
        assert_eq!(stage.batch(at(121), Some(first.mark)).moved, next.moved);
        assert_eq!(stage.batch(at(122), None).moved.len(), 2);
    }

    #[test]
    fn nobody_looks_more_often_than_the_period_however_many_follow() {
        let (mut stage, state) = stage();
        for ms in 0..600 {
            stage.batch(at(ms), None);
        }
        assert_eq!(state.borrow().2, 10);
    }

    #[test]
    fn what_changes_by_less_than_its_resolution_is_not_told_until_it_has_added_up() {
        let (mut stage, state) = stage();
        let mut mark = stage.batch(at(0), None).mark;
        let mut told = Vec::new();
        for step in 1..=10_u32 {
            *state.borrow_mut() = (0.0, 0.03 * f64::from(step), 1);
            let batch = stage.batch(at(60 * u64::from(step)), Some(mark));
            mark = batch.mark;
            told.extend(batch.moved.iter().map(|_| step));
        }
        assert_eq!(told, [4, 8]);
    }

    #[test]
    fn a_number_that_is_none_any_more_or_is_one_again_is_told() {
        let (mut stage, state) = stage();
        let mut mark = stage.batch(at(0), None).mark;
        let mut told = Vec::new();
        for (step, weight) in (1..).zip([f64::NAN, f64::NAN, 0.0, 0.0]) {
            state.borrow_mut().1 = weight;
            let batch = stage.batch(at(60 * step), Some(mark));
            mark = batch.mark;
            told.push(batch.moved.len());
        }
        assert_eq!(told, [1, 0, 1, 0]);
    }

    #[test]
    fn a_mark_of_another_run_counts_as_none() {
        let (mut stage, _) = stage();
        let first = stage.batch(at(5), None);
        let other = Mark {
            run: first.mark.run + 1,
            ..first.mark
        };
        let ahead = Mark {
            seq: first.mark.seq + 1,
            ..first.mark
        };
        for mark in [other, ahead] {
            assert!(stage.batch(at(70), Some(mark)).view.is_some());
        }
    }

    #[test]
    fn a_batch_survives_its_encoding() {
        let (mut stage, _) = stage();
        let batch = stage.batch(at(0), None);
        let bytes = postcard::to_stdvec(&batch).unwrap();
        assert_eq!(postcard::from_bytes::<Batch>(&bytes).unwrap(), batch);
    }

    const APP: &str = "app.until = \"user\"\ntime.mode = \"virtual\"\n[chassis.a]\n[chassis.b]\n[task.ball]\nhandler = \"ball\"\non = \"a\"\n[task.user]\nhandler = \"user\"\non = \"b\"\n";

    struct Shows(Stage);

    impl EventHandler for Shows {
        async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
            match message.command() {
                FollowScene::CODE => self.0.follow(cx, message),
                _ => cx.default_processing(message),
            }
        }
    }

    /// Looks on once and goes away; how often the ball was looked at until its patience was over, and after that.
    struct User(Arc<AtomicU32>);

    impl EventHandler for User {
        async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
            cx.default_processing(message)
        }

        async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
            if phase == Phase::Run {
                let (cx, looks) = (cx.clone(), self.0.clone());
                cx.clone().spawn(async move {
                    let ball = cx.task("ball").await.unwrap();
                    let all = FollowScene {
                        after: None,
                        patience_ms: 0,
                    };
                    let after = Some(cx.call(&ball, all).await.unwrap().mark);
                    let patience_ms = 600;
                    let next = FollowScene { after, patience_ms };
                    let call = cx.call(&ball, next).deadline(Duration::from_millis(100));
                    assert!(call.await.is_err(), "nothing has changed");
                    cx.sleep(Duration::from_secs(1)).await;
                    let then = looks.load(Ordering::Relaxed);
                    cx.sleep(Duration::from_secs(60)).await;
                    let now = looks.load(Ordering::Relaxed);
                    let text = format!("{then} {}", now - then);
                    let (ok, json) = (true, String::new());
                    cx.finish(AppResult { ok, text, json });
                });
            }
            Ok(())
        }
    }

    struct Counted(Ball, Arc<AtomicU32>);

    impl Source for Counted {
        fn view(&mut self) -> Option<View> {
            self.0.view()
        }

        fn look(&mut self) -> Seen {
            self.1.fetch_add(1, Ordering::Relaxed);
            self.0.look()
        }
    }

    #[test]
    fn a_viewer_that_went_away_without_a_word_costs_nothing_once_its_patience_is_over() {
        let looks = Arc::new(AtomicU32::new(0));
        let mut registry = Registry::new();
        let of_ball = Arc::clone(&looks);
        registry.handler("ball", &[FollowScene::INFO], move |_| {
            let ball = Ball(Rc::default());
            Ok(Shows(Stage::new(Counted(ball, Arc::clone(&of_ball)))))
        });
        let of_user = Arc::clone(&looks);
        registry.handler("user", &[], move |_| Ok(User(Arc::clone(&of_user))));
        let app = ctos::config::load_texts(&[("app.toml", APP)], &[], &[]).unwrap();
        let simulated = ctos::boot::simulate(app, registry, &[], &(Arc::new(|_: &_| ()) as _));
        match simulated.unwrap().end {
            End::Finished(result) => {
                let (then, later) = result.text.split_once(' ').unwrap();
                // One look for the first answer, then one each period.
                assert!((10..=13).contains(&then.parse().unwrap()), "{then}");
                assert_eq!(later, "0");
            }
            other => panic!("{other:?}"),
        }
    }
}
