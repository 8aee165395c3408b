//! The gate: passes on what stand-ins hand it, and asks the tasks of this app what other sites may ask.

use std::{
    cell::{Cell, RefCell},
    collections::{BTreeMap, BTreeSet},
    rc::Rc,
    sync::Arc,
    time::Duration,
};

use ctos::{
    Blob,
    call::Fault,
    message::{Command as _, CommandInfo, Message, Replier},
    survey::AtReport,
    task::{Context, EventHandler, Handled, HandlerError, NameError, Phase, StopReason},
};
use tokio::sync::{mpsc, oneshot};

use crate::{
    args::{ALL, Args},
    network::{Event, Incoming, Network, Order, Plan},
    proof::{Numbers, Prover},
    sites::{Change, Sites, State},
    stand_in::begin,
    wire::{Asked, Head},
};

ctos::command! {
    /// Passes a message on to a task of another site.
    #[derive(Debug, Clone, PartialEq)]
    pub(crate) struct Pass {
        /// The site.
        pub site: String,
        /// The task there.
        pub task: String,
        /// The command's code.
        pub command: u16,
        /// Whether a reply is waited for.
        pub replies: bool,
        /// How long the caller waits.
        pub left: Duration,
        /// The data, as postcard.
        pub data: Blob,
    } => Result<Blob, Fault>, 0x0001, "pass"
}

/// What the gate takes.
pub(crate) const COMMANDS: [CommandInfo; 1] = [Pass::INFO];

/// How often it is looked whether a site is cut off.
const LOOK: Duration = Duration::from_millis(250);
/// How often a request looks for a site that was not heard yet.
const AWAIT: Duration = Duration::from_millis(50);
/// Requests to other sites that may be under way.
const MOST_ASKING: usize = 1024;
/// Reasons not to believe a site that are told.
const MOST_DOUBTS: usize = 100;

/// The log target of addresses that are served: it is shown where nothing else of its level is.
const LOG_TARGET: &str = "ctos::page";

/// How a request to another site ended; `None` when no gate has answered.
type Answer = Option<Result<Vec<u8>, Fault>>;

/// A request that is under way to another site.
struct Open {
    site: String,
    answer: oneshot::Sender<Answer>,
}

/// What all parts of the task share.
struct Shared {
    args: Args,
    /// The tasks of this app that run nets.
    nets: BTreeSet<String>,
    run: u64,
    sites: RefCell<Sites>,
    /// Who asks a site that is waited for: one after the other, in the order in which they came.
    turns: BTreeMap<String, tokio::sync::Mutex<()>>,
    network: RefCell<Option<Network>>,
    /// Whether a router is there, and why not.
    there: RefCell<(bool, String)>,
    open: RefCell<BTreeMap<u64, Open>>,
    /// The number of the next request.
    next: Cell<u64>,
    /// How much of other sites was refused.
    refused: Cell<u64>,
    /// The requests of each site that have come.
    come: RefCell<BTreeMap<String, Numbers>>,
    /// Of which sites what was not believed, and why.
    doubted: RefCell<BTreeSet<(String, String)>>,
}

/// The event handler.
pub(crate) struct Gate {
    shared: Rc<Shared>,
}

impl Gate {
    pub(crate) fn new(cx: &Context) -> Result<Self, HandlerError> {
        let args: Args = cx.args()?;
        let clock = cx.chassis().clock().clone();
        let started_ns = cx.outside("date of the host", || {
            clock.started_date_ns().unwrap_or_default()
        });
        let now = cx.now();
        let shared = Shared {
            nets: pnt::task::net_tasks(cx.app(), &cx.registry())
                .into_iter()
                .collect(),
            run: started_ns.saturating_add(now.as_nanos()),
            sites: RefCell::new(Sites::new(args.sites(), now, args.cut_after())),
            turns: args
                .sites()
                .into_iter()
                .map(|site| (site, <_>::default()))
                .collect(),
            network: RefCell::default(),
            there: RefCell::new((false, "no router was reached yet".to_owned())),
            open: RefCell::default(),
            next: Cell::new(1),
            refused: Cell::new(0),
            come: RefCell::default(),
            doubted: RefCell::default(),
            args,
        };
        Ok(Self {
            shared: Rc::new(shared),
        })
    }

    fn plan(&self, cx: &Context) -> Result<Plan, HandlerError> {
        let (args, app) = (&self.shared.args, cx.app());
        let keys = app.security.as_ref().map(|security| {
            let path =
                |file: &std::path::Path| app.folder.join(file).to_string_lossy().into_owned();
            let key = path(&security.key);
            [
                format!("{key}.pem"),
                format!("{key}.key"),
                path(&security.authority),
            ]
        });
        Ok(Plan {
            prover: Arc::new(Prover::new(app, &args.name).map_err(HandlerError::new)?),
            site: args.name.clone(),
            run: self.shared.run,
            others: args.sites(),
            connect: args.connect.clone(),
            listen: args.listen.clone(),
            keys,
            clock: cx.chassis().clock().clone(),
        })
    }

    /// Joins the network, and hears what comes from there.
    fn join(&self, cx: &Context) -> Handled {
        let (events, come) = mpsc::unbounded_channel();
        let network = Network::join(self.plan(cx)?, events);
        let network = network.map_err(|error| HandlerError::new(format!("no thread: {error}")))?;
        self.shared.network.replace(Some(network));
        let (child, shared) = (cx.clone(), Rc::clone(&self.shared));
        cx.spawn(async move { hear(&child, &shared, come).await });
        Ok(())
    }
}

impl EventHandler for Gate {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            Pass::CODE => {
                let cx = cx.within(message.trace());
                let (pass, reply) = message.open::<Pass>()?;
                let shared = Rc::clone(&self.shared);
                begin(&cx.clone(), async move {
                    let ended = shared.pass(&cx, pass, &reply).await;
                    // A reply cannot fail.
                    let _ = reply.ok(ended.map(Blob::from));
                });
                Ok(())
            }
            _ => cx.default_processing(message),
        }
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase != Phase::Create {
            return Ok(());
        }
        // In virtual time, and in a replay, nobody takes part: every other site is cut off.
        if cx.chassis().clock().origin_ns().is_some() && !cx.is_replay() {
            cx.reads_unrecorded("a network of sites");
            self.join(cx)?;
        }
        let (child, shared) = (cx.clone(), Rc::clone(&self.shared));
        cx.spawn(async move {
            loop {
                let changes = shared.sites.borrow_mut().look(child.now());
                shared.changed(&child, changes);
                shared.show(&child);
                child.sleep(LOOK).await;
            }
        });
        Ok(())
    }

    async fn stop(&mut self, _cx: &Context, _reason: &StopReason) -> Handled {
        self.shared.network.take();
        Ok(())
    }
}

/// Takes what comes from the network.
async fn hear(cx: &Context, shared: &Rc<Shared>, mut events: mpsc::UnboundedReceiver<Event>) {
    while let Some(event) = events.recv().await {
        match event {
            Event::There(there, why) => {
                let site = &shared.args.name;
                match there {
                    true => {
                        tracing::info!(target: LOG_TARGET, task = cx.name(), site, "the network of sites is there")
                    }
                    false => tracing::warn!(
                        task = cx.name(),
                        site,
                        why,
                        "the network of sites is not there; it is looked for each second"
                    ),
                }
                shared.there.replace((there, why));
            }
            Event::Heard(site, beat, now) => {
                let changes = shared.sites.borrow_mut().heard(&site, beat, now);
                shared.changed(cx, changes);
            }
            Event::Doubted(site, why) => shared.doubt(cx, site, why),
            Event::Answered(number, answer) => {
                let open = shared.open.borrow_mut().remove(&number);
                if let Some(open) = open {
                    // Who asked may have given up.
                    let _ = open.answer.send(answer);
                }
            }
            Event::Asked {
                asked,
                head,
                bytes,
                to,
            } => shared.asked(cx, asked, head, bytes, *to).await,
        }
    }
}

impl Shared {
    /// Says how it is.
    fn show(&self, cx: &Context) {
        let mut text = self.sites.borrow().words(cx.now());
        let (there, why) = &*self.there.borrow();
        if !there {
            text = format!("{why}; {text}");
        }
        let refused = self.refused.get();
        if refused > 0 {
            text = format!("{text}; {refused} messages of others were refused");
        }
        cx.is_at(Some(AtReport { text, until: None }));
    }

    /// Tells what has changed about sites, and ends what waits for those that do not answer any more.
    fn changed(&self, cx: &Context, changes: Vec<Change>) {
        for change in changes {
            match change {
                Change::Back(site, None) => {
                    tracing::info!(target: LOG_TARGET, task = cx.name(), site, "a site is there");
                }
                Change::Back(site, Some(after)) => {
                    let after_s = after.as_secs_f64();
                    tracing::info!(target: LOG_TARGET, task = cx.name(), site, after_s, "a site is there again");
                }
                Change::Cut(site, after) => {
                    let after_s = after.as_secs_f64();
                    tracing::warn!(task = cx.name(), site, after_s, "a site is cut off");
                    self.give_up(&site);
                }
                Change::Anew(site) => {
                    tracing::warn!(
                        task = cx.name(),
                        site,
                        "the gate of a site was started anew"
                    );
                    self.give_up(&site);
                }
                Change::Foreign(site, version) => {
                    tracing::warn!(
                        task = cx.name(),
                        site,
                        version,
                        "the gate of a site speaks another version: run the same program at both sites"
                    );
                }
            }
        }
    }

    /// Nobody at a site will answer what was asked so far.
    fn give_up(&self, site: &str) {
        let mut open = self.open.borrow_mut();
        let lost: Vec<u64> = open
            .iter()
            .filter(|(_, open)| open.site == site)
            .map(|(number, _)| *number)
            .collect();
        for number in lost {
            if let Some(open) = open.remove(&number) {
                let _ = open.answer.send(None);
            }
        }
    }

    // -- what this site asks ----------------------------------------------------------------

    fn cut_off(&self, cx: &Context, site: &str, asked: bool) -> Fault {
        Fault::CutOff {
            site: site.to_owned(),
            after: self.sites.borrow().silent(site, cx.now()),
            asked,
        }
    }

    /// Waits for a site that was not heard yet; the run of its gate.
    async fn run_of(&self, cx: &Context, site: &str) -> Result<u64, Fault> {
        loop {
            let state = self.sites.borrow().state(site, cx.now());
            match state {
                Some(State::There(run)) => return Ok(run),
                Some(State::Awaited) => cx.sleep(AWAIT).await,
                Some(State::Cut(_)) | None => return Err(self.cut_off(cx, site, false)),
            }
        }
    }

    /// Asks a task of another site. Ends at the caller's deadline, and when the site is cut off.
    async fn pass(
        &self,
        cx: &Context,
        pass: Pass,
        reply: &Replier<Pass>,
    ) -> Result<Vec<u8>, Fault> {
        let Pass {
            site,
            task,
            command,
            replies,
            left,
            data,
        } = pass;
        let until = cx.now() + left;
        let turn = match self.turns.get(&site) {
            Some(turn) => Some(turn.lock().await),
            None => None,
        };
        let run = self.run_of(cx, &site).await?;
        let rest = until.since(cx.now());
        if rest.is_zero() || reply.is_abandoned() {
            return Err(Fault::Deadline { after: left });
        }
        if self.open.borrow().len() >= MOST_ASKING {
            let capacity = MOST_ASKING;
            return Err(Fault::Full { capacity });
        }
        let asked = Asked {
            from: self.args.name.clone(),
            task,
            command,
        };
        let number = self.next.replace(self.next.get() + 1);
        let (answer, came) = oneshot::channel();
        let open = Open {
            site: site.clone(),
            answer,
        };
        self.open.borrow_mut().insert(number, open);
        let order = Order::Ask {
            site: site.clone(),
            key: asked.key(&site, run),
            head: Head::new(rest, replies, self.run, number),
            bytes: data.into_inner().into(),
        };
        let ordered = match &*self.network.borrow() {
            Some(network) => network.order(order),
            None => Err(Fault::Stopping),
        };
        drop(turn);
        let answer = match ordered {
            Ok(()) => cx.timeout(rest, came).await,
            Err(fault) => {
                self.open.borrow_mut().remove(&number);
                return Err(fault);
            }
        };
        self.open.borrow_mut().remove(&number);
        match answer {
            Ok(Ok(Some(answer))) => answer,
            // Nobody was there, or is any more.
            Ok(Ok(None) | Err(_)) => Err(self.cut_off(cx, &site, true)),
            // A cut that is too short to be called so.
            Err(_) if self.sites.borrow().silent(&site, cx.now()) > 2 * crate::network::BEAT => {
                Err(self.cut_off(cx, &site, true))
            }
            Err(_) => Err(Fault::Deadline { after: left }),
        }
    }

    // -- what other sites ask ---------------------------------------------------------------

    /// Another site asks. The request has begun when this returns, which keeps requests in their order.
    async fn asked(
        self: &Rc<Self>,
        cx: &Context,
        asked: Asked,
        head: Head,
        data: Vec<u8>,
        to: Incoming,
    ) {
        let cx = cx.new_trace();
        let call = match self.permitted(&cx, &asked, head) {
            Ok(command) => self.call(&cx, &asked, command, head, data).await,
            Err(fault) => Err(fault),
        };
        match call {
            Err(fault) => self.answer(to, Err(fault)),
            Ok(call) => {
                let shared = Rc::clone(self);
                begin(&cx, async move {
                    let answer = call.await;
                    shared.answer(to, answer.map_err(|error| error.fault));
                });
            }
        }
    }

    /// Finds the task, and makes the call, which is not begun.
    async fn call(
        &self,
        cx: &Context,
        asked: &Asked,
        command: CommandInfo,
        head: Head,
        data: Vec<u8>,
    ) -> Result<
        std::pin::Pin<Box<dyn Future<Output = Result<Vec<u8>, ctos::call::CallError>>>>,
        Fault,
    > {
        // Whoever waits for a chassis that is being restarted would keep all others waiting.
        let found = cx.task(&asked.task).deadline(Duration::ZERO).await;
        let task = found.map_err(|error| match error {
            // It is configured, as what is permitted was looked at: it may be back.
            NameError::NotBack { chassis, .. } | NameError::Gone { chassis, .. } => {
                Fault::PeerDown { chassis }
            }
            NameError::Service(error) => error.fault,
            _ => Fault::UnknownTask,
        })?;
        let data = match self.nets.contains(&asked.task) {
            true => pnt::task::from_site(asked.command, data, &asked.from),
            false => data,
        };
        Ok(match head.replies {
            true => Box::pin(cx.call_raw(&task, command, data, head.left())),
            false => {
                let send = cx.send_raw(&task, command, data).deadline(head.left());
                Box::pin(async move { send.await.map(|()| Vec::new()) })
            }
        })
    }

    /// The command, if the site may ask it.
    fn permitted(&self, cx: &Context, asked: &Asked, head: Head) -> Result<CommandInfo, Fault> {
        let Asked {
            from,
            task,
            command,
        } = asked;
        let here = &self.args.name;
        let refuse = |text: String| {
            self.refused.set(self.refused.get() + 1);
            tracing::warn!(task = cx.name(), from, "{text}");
            Err(Fault::Refused { text })
        };
        let allowed = self.args.allow.get(from).and_then(|tasks| tasks.get(task));
        let Some(allowed) = allowed else {
            return refuse(format!(
                "site `{here}` lets site `{from}` ask nothing of `{task}`: its [site.allow.{from}] does not name it"
            ));
        };
        let config = cx.app().task(task);
        let commands = config.map(|config| cx.registry().commands_of(config, cx.app()));
        let commands = commands.unwrap_or_default();
        let Some(info) = commands.iter().find(|info| info.code == *command) else {
            let takes = commands.iter().map(|info| info.name.to_owned()).collect();
            return Err(Fault::UnknownCommand { takes });
        };
        if !allowed.iter().any(|name| name == ALL || name == info.name) {
            return refuse(format!(
                "site `{here}` lets site `{from}` not ask `{}` of `{task}`, only {}",
                info.name,
                allowed.join(", ")
            ));
        }
        let mut come = self.come.borrow_mut();
        if !come
            .entry(from.clone())
            .or_default()
            .take(head.run, head.number)
        {
            return refuse(format!(
                "site `{here}` has had this request of site `{from}` before: a router repeats or withholds what it carries"
            ));
        }
        Ok(*info)
    }

    /// Counts what is not believed of a site. Whoever lies can do so often, so a reason is told once for a site, and few in all.
    fn doubt(&self, cx: &Context, site: String, why: String) {
        self.refused.set(self.refused.get() + 1);
        let mut doubted = self.doubted.borrow_mut();
        if doubted.len() < MOST_DOUBTS && doubted.insert((site.clone(), why.clone())) {
            tracing::warn!(task = cx.name(), site, "{why}");
        }
    }

    fn answer(&self, to: Incoming, answer: Result<Vec<u8>, Fault>) {
        let order = Order::Answer { to, answer };
        if let Some(network) = &*self.network.borrow()
            && network.order(order).is_err()
        {
            tracing::warn!("an answer for another site is lost: the network does not keep up");
        }
    }
}
