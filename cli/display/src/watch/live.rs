//! The nets of a running app, followed over its control socket: a thread for each net, which asks for what
//! is new and hands it on.

use std::{
    collections::BTreeMap,
    sync::mpsc::{Receiver, SyncSender, sync_channel},
    time::Duration,
};

use ctos::{
    control::protocol::{Answer, Request},
    registry::Registry,
};
use pnt::{
    layout::{Detail, Drawing},
    stream::{Batch, Describe, Event, EventPhase, Follow, NetView, Replica, State},
    task::{COMMANDS, Marking},
};

use cli_common::{
    client::{Client, ClientError},
    remote::RemoteArgs,
};

/// How long a net waits for something to happen, and how much longer its answer may take.
const PATIENCE_MS: u32 = 1_000;
const LIMIT: Duration = Duration::from_secs(4);
/// How long after a net was lost it is looked for again.
const RETRY: Duration = Duration::from_millis(500);
/// News that may wait to be taken in.
const BEHIND: usize = 256;
/// Events of each net that are kept.
const KEPT: usize = 200;

/// What a thread tells.
enum News {
    Net(Box<NetView>, Box<State>),
    Batch(String, Box<Batch>),
    Breakpoints(String, Vec<String>),
    Lost(String, String),
}

/// A net that is followed.
pub(super) struct Live {
    pub(super) view: NetView,
    /// Its nodes and arcs, in its author's words.
    pub(super) drawing: Drawing,
    replica: Replica,
    pub(super) events: Vec<Event>,
    pub(super) breakpoints: Vec<String>,
    pub(super) gone: Option<String>,
}

impl Live {
    pub(super) fn state(&self) -> &State {
        self.replica.state()
    }
}

/// The nets of an app.
pub(super) struct Nets {
    pub(super) app: String,
    pub(super) nets: BTreeMap<String, Live>,
    news: Receiver<News>,
    expected: usize,
}

impl Nets {
    /// Begins to follow the nets of an app, or one of them.
    ///
    /// # Errors
    /// The app cannot be reached.
    pub(super) fn follow(
        remote: &RemoteArgs,
        only: Option<&str>,
        registry: &Registry,
    ) -> Result<Self, ClientError> {
        let mut client = remote.connect()?;
        let mut names = Vec::new();
        if let Answer::App(view) = client.get(Request::Ps {})? {
            let runs_net = |handler: &str| {
                let kind = registry.kind(handler);
                kind.is_some_and(|kind| COMMANDS.iter().all(|one| kind.commands().contains(one)))
            };
            // What stands for a net at another site runs none itself, and is shown when it is named.
            let abroad = |name: &str| only == Some(name) && name.contains('@');
            let tasks = view.tasks.into_iter();
            let tasks = tasks.filter(|task| runs_net(&task.handler) || abroad(&task.name));
            names.extend(tasks.map(|task| task.name));
        }
        names.retain(|name| only.is_none_or(|only| only == name));
        let (sender, news) = sync_channel(BEHIND);
        let expected = names.len();
        for name in names {
            let (remote, sender) = (remote.clone(), sender.clone());
            std::thread::spawn(move || follow(&remote, &name, &sender));
        }
        Ok(Self {
            app: client.app().app.clone(),
            nets: BTreeMap::new(),
            news,
            expected,
        })
    }

    /// Takes in what is new, for at most so long; whether there was something.
    pub(super) fn take_in(&mut self, wait: Duration) -> bool {
        let mut next = self.news.recv_timeout(wait).ok();
        let any = next.is_some();
        while let Some(news) = next {
            self.take(news);
            next = self.news.try_recv().ok();
        }
        any
    }

    /// Waits until all nets are known, or it takes too long.
    pub(super) fn complete(&mut self) {
        while self.nets.len() < self.expected && self.take_in(LIMIT) {}
    }

    fn take(&mut self, news: News) {
        match news {
            News::Net(view, state) => {
                if let Ok(replica) = Replica::new(&view, *state) {
                    let net = Live {
                        drawing: Drawing::new(&view, Detail::Written),
                        view: *view,
                        replica,
                        events: Vec::new(),
                        breakpoints: Vec::new(),
                        gone: None,
                    };
                    self.nets.insert(net.view.name.clone(), net);
                }
            }
            News::Batch(name, batch) => {
                let Some(net) = self.nets.get_mut(&name) else {
                    return;
                };
                net.gone = None;
                if let Some(state) = batch.state {
                    // A net that was replaced by another one is described anew when its stream is.
                    let _ = net.replica.set(state);
                }
                for event in batch.events.iter() {
                    if net.replica.apply(event).is_ok() {
                        net.events.push(event.clone());
                    }
                }
                net.events.drain(..net.events.len().saturating_sub(KEPT));
            }
            News::Breakpoints(name, breakpoints) => {
                if let Some(net) = self.nets.get_mut(&name) {
                    net.breakpoints = breakpoints;
                }
            }
            News::Lost(name, reason) => {
                if let Some(net) = self.nets.get_mut(&name) {
                    net.gone = Some(reason);
                } else {
                    self.expected = self.expected.saturating_sub(1);
                }
            }
        }
    }
}

/// Follows one net until nobody listens any more.
fn follow(remote: &RemoteArgs, name: &str, news: &SyncSender<News>) {
    loop {
        let lost = match stream(remote, name, news) {
            Ok(()) => return,
            Err(error) => error.to_string(),
        };
        if news.send(News::Lost(name.to_owned(), lost)).is_err() {
            return;
        }
        // This is no part of an app, and has no clock of one.
        std::thread::park_timeout(RETRY);
    }
}

/// `Ok` when nobody listens any more.
fn stream(remote: &RemoteArgs, name: &str, news: &SyncSender<News>) -> Result<(), ClientError> {
    let mut client: Client = remote.connect()?;
    let mut view = Some(client.call(name, Describe {}, LIMIT)?);
    let mut after = None;
    loop {
        let follow = Follow {
            after,
            patience_ms: PATIENCE_MS,
        };
        let mut batch = client.call(name, follow, LIMIT)?;
        after = Some(batch.mark);
        // A net at another site is called otherwise there.
        if let Some(state) = &mut batch.state {
            name.clone_into(&mut state.net);
        }
        // Those that it began with, and what a person did since.
        let ordered = |event: &Event| event.phase == EventPhase::Ordered;
        let sets = view.is_some() || batch.events.iter().any(ordered);
        if view.is_some()
            && let (Some(mut view), Some(state)) = (view.take(), batch.state.take())
        {
            name.clone_into(&mut view.name);
            let net = News::Net(Box::new(view), Box::new(state));
            if news.send(net).is_err() {
                return Ok(());
            }
        }
        if news
            .send(News::Batch(name.to_owned(), Box::new(batch)))
            .is_err()
        {
            return Ok(());
        }
        if sets {
            let set = client.call(name, Marking {}, LIMIT)?.breakpoints;
            if news.send(News::Breakpoints(name.to_owned(), set)).is_err() {
                return Ok(());
            }
        }
    }
}
