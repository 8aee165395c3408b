//! Follows what tasks sum up of those below them, and what a page looks at of it: the nets of an app that has many are followed
//! once somebody opens them.

use std::{
    cell::RefCell,
    collections::{BTreeSet, VecDeque},
    rc::Rc,
    time::Duration,
};

use ctos::{
    task::{Context, Handled, HandlerError},
    time::Clock,
};
use scene_summary::{Decide, SumUp};

use super::{hub::Hub, wire::Asked};

/// How often a task is asked, as long as somebody looks.
const EVERY: Duration = Duration::from_millis(500);
/// A task that does not answer for so long is gone.
const SILENCE: Duration = Duration::from_secs(4);
/// How long what a person decides may take.
const DECIDED_WITHIN: Duration = Duration::from_secs(10);

/// Where something sums up an app with more nets than this, they are followed when somebody opens them.
const MANY_NETS: usize = 24;

/// Whether so many nets are followed only when somebody opens them.
pub(super) fn are_opened(cx: &Context, nets: usize) -> bool {
    nets > MANY_NETS && !scene_summary::sources(cx.app(), &cx.registry()).is_empty()
}
/// So many of those are followed at a time. The one that was opened first is left for another one.
const MOST_OPEN: usize = 12;

/// Follows one task for good, through the end and the return of its chassis.
pub(super) async fn follow(cx: &Context, source: &str, hub: &Hub) {
    let mut after = None;
    loop {
        if hub.is_watched()
            && let Err(error) = ask(cx, source, hub, &mut after).await
        {
            after = None;
            hub.unsummed(source, &error.to_string());
        }
        cx.sleep(EVERY).await;
    }
}

async fn ask(
    cx: &Context,
    source: &str,
    hub: &Hub,
    after: &mut Option<scene_summary::Mark>,
) -> Handled {
    let to = cx.task(source).deadline(SILENCE).await?;
    let step = cx.call(&to, SumUp { after: *after }).deadline(SILENCE);
    let step = step.await?;
    *after = step.mark;
    hub.summed(source, step);
    Ok(())
}

/// Tells a task what a person has decided; its answer.
pub(super) async fn decide(cx: &Context, asked: &Asked) -> Result<String, HandlerError> {
    let to = cx.task(&asked.task).deadline(SILENCE).await?;
    let decide = Decide {
        key: asked.key.clone(),
        choice: asked.choice.clone(),
        by: cx.name().to_owned(),
    };
    Ok(cx.call(&to, decide).deadline(DECIDED_WITHIN).await?)
}

/// The nets that are followed because somebody has opened them.
#[derive(Debug, Clone, Default)]
pub(super) struct Opened(Rc<RefCell<Open>>);

#[derive(Debug, Default)]
struct Open {
    /// The earliest first.
    nets: VecDeque<String>,
    /// Those that have a follower, which may not have noticed yet that its net was left.
    followed: BTreeSet<String>,
}

impl Opened {
    /// Somebody opens a net; whether a follower is to be started for it.
    pub(super) fn open(&self, net: &str) -> bool {
        if !self.has(net) {
            let mut open = self.0.borrow_mut();
            open.nets.push_back(net.to_owned());
            if open.nets.len() > MOST_OPEN {
                open.nets.pop_front();
            }
        }
        self.0.borrow_mut().followed.insert(net.to_owned())
    }

    /// Whether it is still to be followed.
    pub(super) fn has(&self, net: &str) -> bool {
        self.0.borrow().nets.iter().any(|one| one == net)
    }

    /// Whether it has a follower.
    pub(super) fn is_followed(&self, net: &str) -> bool {
        self.0.borrow().followed.contains(net)
    }

    /// Its follower ends.
    pub(super) fn ends(&self, net: &str) {
        self.0.borrow_mut().followed.remove(net);
    }
}

/// How long virtual time runs before it is compared with the clock of the host.
const TICK: Duration = Duration::from_millis(20);

/// Keeps virtual time from running faster than `pace` times the clock of the host. A simulated app is one thread: while
/// this task waits, nothing else goes on. An app that takes longer to compute is slower than that.
pub(super) async fn keep_pace(cx: &Context, pace: f64) {
    let clock = Clock::real();
    loop {
        let due = clock.now() + TICK;
        cx.sleep(TICK.mul_f64(pace)).await;
        wait_until(&clock, due);
    }
}

/// Stops this thread until then.
fn wait_until(clock: &Clock, due: ctos::time::Instant) {
    loop {
        let left = due.since(clock.now());
        if left.is_zero() {
            return;
        }
        std::thread::park_timeout(left);
    }
}

/// Gives browsers so much time of the host to hear what they were told.
pub(super) fn linger(time: Duration) {
    let clock = Clock::real();
    wait_until(&clock, clock.now() + time);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_the_nets_that_were_opened_the_earliest_is_left_for_another_one() {
        let opened = Opened::default();
        let names: Vec<String> = (0..=MOST_OPEN).map(|net| format!("n{net}")).collect();
        assert!(names.iter().all(|net| opened.open(net)));
        assert!(!opened.open(&names[3]));
        assert!(!opened.has(&names[0]));
        assert!(names[1..].iter().all(|net| opened.has(net)));
    }

    #[test]
    fn a_net_that_is_opened_again_before_its_follower_has_noticed_that_it_was_left_gets_no_second_one()
     {
        let opened = Opened::default();
        assert!(opened.open("away"));
        let others: Vec<String> = (0..MOST_OPEN).map(|net| format!("n{net}")).collect();
        assert!(others.iter().all(|net| opened.open(net)));
        assert!(!opened.has("away"), "it was left");
        assert!(
            !opened.open("away"),
            "its follower still waits for its chassis"
        );
        assert!(opened.has("away"), "and goes on");
        // This one was left for it, and its follower notices that.
        assert!(!opened.has(&others[0]));
        opened.ends(&others[0]);
        assert!(opened.open(&others[0]), "it needs another one");
    }
}
