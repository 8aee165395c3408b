//! The gate's session with the network, on a thread of its own: zenoh waits on whatever thread calls it. The gate sends
//! [`Order`]s and hears [`Event`]s; neither waits for the other. Knows no task.

use std::{
    collections::BTreeSet,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
        mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel},
    },
    time::Duration,
};

use bridge_zenoh::Joining;
use ctos::{
    call::Fault,
    time::{Clock, Instant},
};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};
use zenoh::{
    Session, Wait,
    pubsub::{Publisher, Subscriber},
    qos::{CongestionControl, Priority},
    query::{Query, QueryTarget, Queryable, Reply},
    sample::Sample,
};

use crate::wire::{Asked, Beat, Ended, Head, VERSION, all_asks, beat_key, read, written};

/// What may wait to be sent.
const ORDERS: usize = 1024;
/// Requests of other sites that may be under way here.
const MOST_SERVED: usize = 1024;
/// How often a gate tells that it is there.
pub(crate) const BEAT: Duration = Duration::from_millis(500);
/// How long an attempt to reach a router may take, and the pause after it.
const RETRY: Duration = Duration::from_secs(1);
/// A router that is silent for so long is given up, and looked for again.
const LEASE: Duration = Duration::from_secs(4);
/// zenoh forgets a request so long after its caller did.
const GRACE: Duration = Duration::from_secs(1);

/// How to join the network.
#[derive(Debug, Clone)]
pub(crate) struct Plan {
    /// This site.
    pub site: String,
    /// Which run of its gate this is.
    pub run: u64,
    /// The sites that are listened for.
    pub others: BTreeSet<String>,
    pub connect: Vec<String>,
    /// Where others connect: it is a router then.
    pub listen: Vec<String>,
    /// Certificate, its private half and the authority's certificate, as paths.
    pub keys: Option<[String; 3]>,
    pub clock: Clock,
}

/// What the network is asked.
pub(crate) enum Order {
    /// Asks a gate something.
    Ask {
        number: u64,
        key: String,
        head: Head,
        bytes: Vec<u8>,
    },
    /// Answers a gate.
    Answer {
        to: Incoming,
        answer: Result<Vec<u8>, Fault>,
    },
}

/// A request of another site, which ends unanswered when it is dropped.
#[derive(Debug)]
pub(crate) struct Incoming {
    query: Query,
    _place: OwnedSemaphorePermit,
}

/// What the network tells.
#[derive(Debug)]
pub(crate) enum Event {
    /// A router is there, or is not; with why, where that is known.
    There(bool, String),
    /// A gate told that it is there.
    Heard(String, Beat, Instant),
    /// Another site asks.
    Asked {
        asked: Asked,
        head: Head,
        bytes: Vec<u8>,
        to: Incoming,
    },
    /// A request has its end; `None` when no gate has answered.
    Answered(u64, Option<Result<Vec<u8>, Fault>>),
}

/// The gate's end.
pub(crate) struct Network {
    orders: SyncSender<Order>,
}

impl Network {
    /// Joins the network as soon as it is there, and whenever it comes back.
    ///
    /// # Errors
    /// There is no thread for it.
    pub fn join(plan: Plan, events: mpsc::UnboundedSender<Event>) -> std::io::Result<Self> {
        let (orders, asked) = sync_channel(ORDERS);
        std::thread::Builder::new()
            .name("site".to_owned())
            .spawn(move || run(&plan, &asked, &events))?;
        Ok(Self { orders })
    }

    /// Hands over an order.
    ///
    /// # Errors
    /// Too much waits already: the network does not keep up.
    pub fn order(&self, order: Order) -> Result<(), Fault> {
        let full = |_| Fault::Full { capacity: ORDERS };
        self.orders.try_send(order).map_err(full)
    }
}

/// Tells the gate, unless it has ended.
fn tell(events: &mpsc::UnboundedSender<Event>, event: Event) {
    if events.send(event).is_err() {
        tracing::debug!("the gate has ended");
    }
}

/// Until the gate has ended.
fn run(plan: &Plan, orders: &Receiver<Order>, events: &mpsc::UnboundedSender<Event>) {
    let mut told = String::new();
    loop {
        let why = match open(plan) {
            Ok(session) => {
                told.clear();
                let joined = Joined::new(plan, session, events);
                match joined.and_then(|joined| joined.serve(plan, orders, events)) {
                    Ok(()) => return,
                    Err(error) => error.to_string(),
                }
            }
            Err(error) => error.to_string(),
        };
        if told != why {
            tell(events, Event::There(false, why.clone()));
            told = why;
        }
        // What was asked meanwhile ends when its site counts as cut off.
        let until = plan.clock.now() + RETRY;
        loop {
            match orders.recv_timeout(until.since(plan.clock.now())) {
                Ok(_) => {}
                Err(RecvTimeoutError::Timeout) => break,
                Err(RecvTimeoutError::Disconnected) => return,
            }
        }
    }
}

fn open(plan: &Plan) -> Result<Session, zenoh::Error> {
    let joining = Joining {
        connect: &plan.connect,
        listen: &plan.listen,
        keys: plan.keys.as_ref(),
        patience: RETRY,
        stamps: false,
        lease: Some(LEASE),
    };
    joining.join()
}

/// A session and all that is declared in it.
struct Joined {
    session: Session,
    beat: Publisher<'static>,
    there: Option<bool>,
    _subscribers: Vec<Subscriber<()>>,
    _asks: Queryable<()>,
}

impl Joined {
    fn new(
        plan: &Plan,
        session: Session,
        events: &mpsc::UnboundedSender<Event>,
    ) -> Result<Self, zenoh::Error> {
        let beat = session
            .declare_publisher(beat_key(&plan.site))
            .congestion_control(CongestionControl::Drop)
            .priority(Priority::InteractiveHigh)
            .express(true)
            .wait()?;
        let mut subscribers = Vec::new();
        for site in &plan.others {
            let (name, events, clock) = (site.clone(), events.clone(), plan.clock.clone());
            let subscriber = session
                .declare_subscriber(beat_key(site))
                .callback(move |sample: Sample| {
                    if let Some(beat) = read(&sample.payload().to_bytes()) {
                        tell(&events, Event::Heard(name.clone(), beat, clock.now()));
                    }
                })
                .wait()?;
            subscribers.push(subscriber);
        }
        let (places, events) = (Arc::new(Semaphore::new(MOST_SERVED)), events.clone());
        let asks = session
            .declare_queryable(all_asks(&plan.site, plan.run))
            .callback(move |query: Query| match asked(query, &places) {
                Ok(event) => tell(&events, event),
                Err((query, fault)) => answer(&query, Err(fault)),
            })
            .wait()?;
        Ok(Self {
            session,
            beat,
            there: None,
            _subscribers: subscribers,
            _asks: asks,
        })
    }

    /// Does what is ordered until the gate has ended.
    ///
    /// # Errors
    /// The session is over.
    fn serve(
        mut self,
        plan: &Plan,
        orders: &Receiver<Order>,
        events: &mpsc::UnboundedSender<Event>,
    ) -> Result<(), zenoh::Error> {
        let mut next = plan.clock.now();
        loop {
            let now = plan.clock.now();
            if now >= next {
                next = now + BEAT;
                self.look(plan, events)?;
                let beat = Beat {
                    version: VERSION,
                    run: plan.run,
                };
                self.beat.put(written(&beat)).wait()?;
            }
            match orders.recv_timeout(next.since(plan.clock.now())) {
                Ok(Order::Ask {
                    number,
                    key,
                    head,
                    bytes,
                }) => {
                    let awaited = Awaited::new(number, events);
                    self.session
                        .get(key)
                        .payload(bytes)
                        .attachment(written(&head))
                        .target(QueryTarget::BestMatching)
                        .timeout(head.left() + GRACE)
                        .callback(move |reply| awaited.take(&reply))
                        .wait()?;
                }
                Ok(Order::Answer { to, answer: with }) => answer(&to.query, with),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return self.session.close().wait(),
            }
        }
    }

    /// Tells what has changed about the network.
    fn look(
        &mut self,
        plan: &Plan,
        events: &mpsc::UnboundedSender<Event>,
    ) -> Result<(), zenoh::Error> {
        if self.session.is_closed() {
            return Err("the session with the network is over".into());
        }
        // A router is there for whoever comes.
        let there =
            !plan.listen.is_empty() || self.session.info().routers_zid().wait().next().is_some();
        if self.there != Some(there) {
            let text = match there {
                true => String::new(),
                false => format!("no router answers at {}", plan.connect.join(", ")),
            };
            tell(events, Event::There(there, text));
            self.there = Some(there);
        }
        Ok(())
    }
}

/// Who waits for an answer; it is told that there is none when zenoh gives the request up.
struct Awaited {
    number: u64,
    events: mpsc::UnboundedSender<Event>,
    answered: AtomicBool,
}

impl Awaited {
    fn new(number: u64, events: &mpsc::UnboundedSender<Event>) -> Self {
        Self {
            number,
            events: events.clone(),
            answered: AtomicBool::new(false),
        }
    }

    fn take(&self, reply: &Reply) {
        let Ok(sample) = reply.result() else { return };
        let ended = sample
            .attachment()
            .and_then(|bytes| read::<Ended>(&bytes.to_bytes()));
        let answer = match ended {
            Some(Ok(())) => Ok(sample.payload().to_bytes().into_owned()),
            Some(Err(fault)) => Err(fault),
            None => Err(Fault::BadPayload {
                text: "the gate of the other site answered what this one cannot read".to_owned(),
            }),
        };
        if !self.answered.swap(true, Ordering::Relaxed) {
            tell(&self.events, Event::Answered(self.number, Some(answer)));
        }
    }
}

impl Drop for Awaited {
    fn drop(&mut self) {
        if !self.answered.load(Ordering::Relaxed) {
            tell(&self.events, Event::Answered(self.number, None));
        }
    }
}

/// What another site asks; or why not, with whom to tell that.
fn asked(query: Query, places: &Arc<Semaphore>) -> Result<Event, (Query, Fault)> {
    let unreadable = |text: &str| Fault::BadPayload {
        text: text.to_owned(),
    };
    let Some(asked) = Asked::of_key(query.key_expr().as_str()) else {
        return Err((query, unreadable("the key names no task and command")));
    };
    let head = query
        .attachment()
        .and_then(|bytes| read::<Head>(&bytes.to_bytes()));
    let Some(head) = head.filter(|head| head.version == VERSION) else {
        return Err((query, unreadable("the gates speak different versions")));
    };
    let Ok(place) = places.clone().try_acquire_owned() else {
        let capacity = MOST_SERVED;
        return Err((query, Fault::Full { capacity }));
    };
    let payload = query.payload();
    let bytes = payload.map(|payload| payload.to_bytes().into_owned());
    let to = Incoming {
        query,
        _place: place,
    };
    let bytes = bytes.unwrap_or_default();
    Ok(Event::Asked {
        asked,
        head,
        bytes,
        to,
    })
}

fn answer(query: &Query, with: Result<Vec<u8>, Fault>) {
    let (ended, bytes): (Ended, _) = match with {
        Ok(bytes) => (Ok(()), bytes),
        Err(fault) => (Err(fault), Vec::new()),
    };
    let reply = query.reply(query.key_expr().clone(), bytes);
    if let Err(error) = reply.attachment(written(&ended)).wait() {
        tracing::debug!(%error, "who asked is gone");
    }
}
